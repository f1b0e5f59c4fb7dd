"""An entry put together from results: the records of policy, explainer and task, and how it was computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from xmarl_bench.entry.protocol import definitions
from xmarl_bench.entry.provenance import provenance
from xmarl_bench.entry.schema import Entry, ExplainerRecord, PolicyRecord, Protocol, TaskRecord, make_entry
from xmarl_bench.explain.effect import NORMALISER
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.simulator import SIMULATOR
from xmarl_bench.isolation.policies import is_code_here
from xmarl_bench.plugins.registry import is_shipped_code, recorded_origin
from xmarl_bench.policy import CodeArchitecture
from xmarl_bench.policy.device import CPU
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.scoring.cell_result import Controls, cell_result, total_cost
from xmarl_bench.scoring.pieces import Plan
from xmarl_bench.scoring.results import Results
from xmarl_bench.scoring.task_record import task_record


def entry_of(
    plan: Plan, results: Results, controls: Controls, started: str, jobs: int, submitter: str | None
) -> Entry:
    """The entry of a plan whose pieces are complete. started, jobs: of the run."""
    request = plan.request
    card, sampling = request.card, request.sampling
    cells = [
        cell_result(request, cell, needed, results, controls)
        for cell, needed in zip(request.cells, plan.needs, strict=True)
    ]
    return make_entry(
        submitter=submitter,
        policy=PolicyRecord(
            name=card.name,
            task=card.task,
            n_agents=card.n_agents,
            weights_sha256=card.weights_sha256,
            architecture=card.architecture,
            attention_entropy=card.attention_entropy,
            training_seed=card.training_seed,
            trusted_code=isinstance(card.architecture, CodeArchitecture),
            isolated=False if is_code_here(request.policy, card) else None,
        ),
        explainer=explainer_record(request.explainer, sampling.seed),
        protocol=Protocol(
            episodes=sampling.episodes,
            seeds=tuple(sampling.seeds),
            timesteps=sampling.timesteps,
            definitions=definitions(card.architecture.distribution),
            tasks=_task_records(request.cells),
        ),
        results=tuple(result for result, _ in cells),
        cost=total_cost([cost for _, cost in cells]),
        provenance=provenance(
            started, jobs, None if request.explainer.device == CPU else request.explainer.device
        ),
    )


def explainer_record(explainer: Explainer, seed: int) -> ExplainerRecord:
    """The record of an explainer in an entry. seed: of the run."""
    origin = recorded_origin(explainer)
    return ExplainerRecord(
        **asdict(origin),
        name=explainer.name,
        hyperparameters=dict(explainer.hyperparameters),
        stochastic=explainer.stochastic,
        control=explainer.control,
        seed=seed,
        batched=explainer.batched,
        binary=explainer.binary,
        signed=NORMALISER if explainer.signed else None,
        node_importance=explainer.node_importance,
        needs_fit=explainer.fit is not None,
        accesses=SIMULATOR if explainer.simulates else explainer.accesses,
        isolated=None if explainer.elsewhere is not None or is_shipped_code(explainer) else False,
    )


def _task_records(cells: Sequence[Cell]) -> dict[str, TaskRecord] | None:
    """The records of the tasks that are not of xmarl_envs, by name; None without one."""
    records = {cell.task: task_record(cell) for cell in cells}
    return {name: record for name, record in records.items() if record is not None} or None
