"""Scores explainers on policies: rolls the policies out, explains and measures each episode, makes entries.

Work is fanned out by episodes. Bytes of an entry outside `provenance` and `cost` are the same for any
number of jobs and parallel episodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from xmarl_bench.cell_result import Done, cell_result, cost_of
from xmarl_bench.code_origin import origin_of
from xmarl_bench.effect import NORMALISER
from xmarl_bench.entry import Entry, ExplainerRecord, PolicyRecord, Protocol, make_entry
from xmarl_bench.fan_out import check_parallel, fan_out
from xmarl_bench.policy import CodeArchitecture, Policy, PolicyCard
from xmarl_bench.policy_module import PolicyModule
from xmarl_bench.protocol import DEFINITIONS
from xmarl_bench.provenance import now, provenance
from xmarl_bench.registry import FoundExplainer, as_found, find_explainer, open_policy
from xmarl_bench.request import Cell, Request, Sampling
from xmarl_bench.work import check_explainers, fit_explainers, needs, pieces, roll_out_worlds, run, wanted


def score(
    policy: str | Path | PolicyModule | tuple[Policy, PolicyCard],
    explainer: object,
    *,
    task: str | None = None,
    n_agents: int | None = None,
    episodes: int = 50,
    timesteps: int | None = None,
    max_cycles: int | None = None,
    behaviour_episodes: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    parallel_episodes: int = 50,
    progress: bool = False,
    submitter: str | None = None,
    trust_code: bool = False,
) -> Entry:
    """Score one explainer on one policy in one cell.

    Args:
        policy: a registered name, the folder or zip of a bundle, `module:factory`, what `load_policy`
            returns, or a network of your own as a `PolicyModule`.
        explainer: a registered name, `path/to/file.py:Name`, `module:Name`, an `Explainer`, or what
            `as_explainer` makes one of: a function, a class, an algorithm of torch_geometric.explain.
        task, n_agents: what the policy was trained for by default.
        episodes, timesteps, max_cycles, seed: which states, see `Sampling`.
        behaviour_episodes: how many of the episodes the team also plays on the explanation, which asks the
            explainer at every step; all by default, none for explainers that declare themselves slow.
        jobs: processes.
        parallel_episodes: episodes stepped side by side in a process.
        trust_code: run the code that a policy brings, where `policy` names such a one.

    Raises InputError for anything wrong with these.
    """
    if isinstance(policy, str | Path):
        network, card = open_policy(str(policy), trust_code=trust_code)
    elif isinstance(policy, PolicyModule):
        network, card = policy.open(origin_of(policy.network))
    else:
        network, card = policy
    found = find_explainer(explainer) if isinstance(explainer, str) else as_found(explainer)
    cell = Cell(card.task if task is None else task, card.n_agents if n_agents is None else n_agents)
    sampling = Sampling(episodes=episodes, timesteps=timesteps, max_cycles=max_cycles, seed=seed)
    request = Request(network, card, found, (cell,), sampling, behaviour_episodes)
    entries = score_requests(
        [request], jobs=jobs, parallel_episodes=parallel_episodes, progress=progress, submitter=submitter
    )
    return next(iter(entries))


def score_requests(
    requests: Sequence[Request],
    *,
    jobs: int = 1,
    parallel_episodes: int = 50,
    progress: bool = False,
    submitter: str | None = None,
) -> Iterator[Entry]:
    """Yield an entry per request, in order, each as soon as it is complete.

    Every explainer is first tried on one timestep of every policy it is to explain, so that one that does
    not work is refused before anything is yielded. One that fails later stops the run at its entry.
    """
    check_parallel(jobs, parallel_episodes)
    started = now()
    work = fit_explainers(wanted(requests))
    episodes = roll_out_worlds(
        requests, jobs=jobs, parallel_episodes=parallel_episodes, progress="roll out" if progress else None
    )
    check_explainers(work, episodes)
    planned = {key: list(pieces(key, explainers, episodes)) for key, explainers in work.items()}
    results = fan_out(
        run,
        [piece for each in planned.values() for piece in each],
        jobs=jobs,
        progress="explain" if progress else None,
    )
    waiting = iter(planned.items())
    done = Done(episodes)
    for request in requests:
        for cell in request.cells:
            for key, _, _ in needs(request, cell):
                while key not in done.results:
                    other, its_pieces = next(waiting)
                    done.results[other] = list(islice(results, len(its_pieces)))
        yield _entry(request, done, started, jobs, submitter)


def _entry(request: Request, done: Done, started: str, jobs: int, submitter: str | None) -> Entry:
    card, found, sampling = request.card, request.explainer, request.sampling
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
        ),
        explainer=explainer_record(found, sampling.seed),
        protocol=Protocol(
            episodes=sampling.episodes,
            seeds=tuple(sampling.seeds),
            timesteps=sampling.timesteps,
            definitions=DEFINITIONS,
        ),
        results=tuple(cell_result(request, cell, done) for cell in request.cells),
        cost=cost_of(request, done),
        provenance=provenance(started, jobs),
    )


def explainer_record(found: FoundExplainer, seed: int) -> ExplainerRecord:
    """What an entry says of its explainer. seed: of the run."""
    explainer = found.explainer
    return ExplainerRecord(
        name=explainer.name,
        distribution=found.distribution,
        version=found.version,
        entry_point=found.entry_point,
        hyperparameters=dict(explainer.hyperparameters),
        stochastic=explainer.stochastic,
        control=explainer.control,
        seed=seed,
        batched=explainer.batched,
        binary=explainer.binary,
        signed=NORMALISER if explainer.signed else None,
        needs_fit=explainer.fit is not None,
        accesses=explainer.accesses,
        code_sha256=found.code_sha256,
    )
