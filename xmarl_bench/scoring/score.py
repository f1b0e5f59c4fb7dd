"""Scores explainers on policies: computes the missing pieces, and makes entries of all pieces.

An entry, apart from `provenance` and `cost`, has the same bytes for any workers and any number of parallel
episodes, and whether its pieces come from one run or several.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import RLock
from typing import Any

from xmarl_bench.entry.provenance import now
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError, a_type
from xmarl_bench.explain.adapters import as_explainer
from xmarl_bench.explain.explainer import Explainer, on_device
from xmarl_bench.isolation.conversation import Isolation, end_strangers
from xmarl_bench.isolation.limits import UNLIMITED
from xmarl_bench.isolation.policies import is_code_here, isolate_policy
from xmarl_bench.isolation.tasks import ask_task
from xmarl_bench.origin.references import origin_of
from xmarl_bench.parallel.fan_out import ordered
from xmarl_bench.parallel.workers import ONE_PROCESS, Workers
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.plugins.registry import ask_explainer, ask_policy, checked_name, isolated
from xmarl_bench.policy import CodeArchitecture, Policy, PolicyCard
from xmarl_bench.policy.bundle import with_own_weights
from xmarl_bench.policy.device import CPU
from xmarl_bench.policy.policy_module import PolicyModule
from xmarl_bench.reproducible import torch_defaults
from xmarl_bench.rollout.cell import Cell, Sampling, check_parallel
from xmarl_bench.scoring.arguments import check_submitter
from xmarl_bench.scoring.cache import Cache, Memory
from xmarl_bench.scoring.cell_result import Controls
from xmarl_bench.scoring.entry_records import entry_of
from xmarl_bench.scoring.piece_keys import Keys
from xmarl_bench.scoring.pieces import Piece, Plan
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.results import Results
from xmarl_bench.scoring.run_record import RunRecord
from xmarl_bench.scoring.sweep import Sweep
from xmarl_bench.tasks.sources import register


@dataclass(frozen=True)
class Failed:
    """A request that failed, and why."""

    request: Request
    error: str

    @property
    def name(self) -> str:
        """Of its explainer and policy, as a message names them."""
        return f"{self.request.explainer.name} on {self.request.card.name}"

    def __str__(self) -> str:
        return f"{self.name}: {self.error}"


_turn = RLock()


@contextmanager
def _one_at_a_time() -> Iterator[None]:
    """Threads take turns: a score ends the process's strangers and sets its defaults of torch."""
    with _turn:
        yield


@_one_at_a_time()
@torch_defaults()
def score(
    policy: str | Path | PolicyModule | tuple[Policy, PolicyCard],
    explainer: object,
    *,
    task: str | Callable[..., Any] | None = None,
    n_agents: int | None = None,
    episodes: int = 50,
    timesteps: int | None = None,
    max_cycles: int | None = None,
    behaviour_episodes: int | None = None,
    seed: int = 0,
    device: str = CPU,
    jobs: int = 1,
    parallel_episodes: int = 50,
    progress: bool = False,
    submitter: str | None = None,
    trust_code: bool = False,
    cache: str | Path | None = None,
    isolate: bool = True,
    answer_seconds: float = UNLIMITED.answer_seconds,
) -> Entry:
    """Score one explainer on one policy in one cell.

    Args:
        policy: a registered name, the folder or zip of a bundle, `module:factory`, the result of
            `load_policy`, or a network of your own as a `PolicyModule`.
        explainer: a registered name, `path/to/file.py:Name`, `module:Name`, an `Explainer`, or anything that
            `as_explainer` accepts: a function, a class, an algorithm of torch_geometric.explain.
        task, n_agents: by default those that the policy was trained for. A task of your own is its registered
            name, `module:factory`, or the factory itself: see `PolicyModule`.
        episodes, timesteps, max_cycles, seed: which states, see `Sampling`.
        behaviour_episodes: how many of the episodes the team also plays on the explanation, which calls the
            explainer at every step; by default all, or none if the explainer declares itself slow.
        device: where an explainer computes that declares `any_device`, such as "cuda". Only the CPU repeats
            bit for bit.
        jobs: processes.
        parallel_episodes: episodes stepped in parallel in a process.
        trust_code: run the code of policy and task, if they have their own.
        cache: folder of the cache, see `Cache`; by default nothing is kept.
        isolate: run an explainer that is not shipped, and a policy that is code, each in a process of its
            own, which imports modules from disk: what has changed in this process since its import, or in
            the file, is other code there. False: in this process, for debugging; then the entry says so and
            nothing is kept.
        answer_seconds: wall-clock time in which such a process must answer for an episode.

    The caller's settings of torch (default dtype and device, autocast, inference mode) have no effect. Calls
    in several threads take turns. Raises InputError if an argument is invalid or the explainer fails.
    """
    isolation = Isolation(replace(UNLIMITED, answer_seconds=answer_seconds)) if isolate else None
    sampling = Sampling(episodes=episodes, timesteps=timesteps, max_cycles=max_cycles, seed=seed)
    try:
        given = None if task is None else ask_task(task, isolation, trust_code=trust_code)
        network, card = _opened(policy, isolation, trust_code=trust_code)
        if given is not None:
            register(given)  # the policy may have brought a task of the same name
        if isinstance(explainer, str):
            chosen = on_device(ask_explainer(explainer, isolation), device)
        else:  # its device is set before it is sent to its process
            chosen = isolated(on_device(checked_name(as_explainer(explainer)), device), isolation)
        played = given or ask_task(card.task, isolation, trust_code=trust_code)
        cell = Cell(played.name, card.n_agents if n_agents is None else n_agents)
        request = Request(network, card, chosen, (cell,), sampling, behaviour_episodes)
        outcomes = score_requests(
            [request],
            workers=Workers(jobs),
            parallel_episodes=parallel_episodes,
            progress=progress,
            submitter=submitter,
            cache=None if cache is None or not isolate else Cache(Path(cache)),
        )
        return next(entries_of(outcomes))
    finally:
        end_strangers()


def _opened(
    policy: str | Path | PolicyModule | tuple[Policy, PolicyCard],
    isolation: Isolation | None,
    *,
    trust_code: bool,
) -> tuple[Policy, PolicyCard]:
    if isinstance(policy, str | Path):
        return ask_policy(str(policy), isolation, trust_code=trust_code)
    loaded = isinstance(policy, tuple) and len(policy) == 2 and isinstance(policy[1], PolicyCard)
    if not (loaded or isinstance(policy, PolicyModule)):
        raise InputError(
            f"{a_type(policy)} is not a policy to score: give a name, the folder of a bundle, the "
            f"result of load_policy, or a network as PolicyModule."
        )
    if isolation is not None and (isinstance(policy, PolicyModule) or is_code_here(*policy)):
        return isolate_policy(policy, isolation)
    if isinstance(policy, PolicyModule):
        return open_module(policy, origin_of(policy.network))
    network, card = policy
    if isinstance(card.architecture, CodeArchitecture):
        return policy
    return network, with_own_weights(network, card)


def score_requests(
    requests: Sequence[Request],
    *,
    workers: Workers = ONE_PROCESS,
    parallel_episodes: int = 50,
    progress: bool = False,
    submitter: str | None = None,
    cache: Cache | None = None,
    fresh: bool = False,
    out: Path | None = None,
    in_order: bool = True,
) -> Iterator[Entry | Failed]:
    """Yield an entry per request as soon as it is complete, or why the request failed.

    in_order: after those of all earlier requests. cache: where pieces are kept, in memory by default. fresh:
    compute pieces again that it holds. out: folder of the entries, for `xmarl-bench status`. Raises
    InputError before anything is explained if no explainer works on any policy, if two explainers share a
    name, or if results cannot be written.
    """
    check_parallel(parallel_episodes)
    check_submitter(submitter)
    explainers, started = _by_name(requests), now()
    cache = Memory() if cache is None else cache
    cache.prepare()
    keys = Keys()
    plans = [Plan.of(request, keys) for request in requests]
    if fresh:
        for key in {key for plan in plans for key in plan.piece_keys}:
            cache.remove(key)
    if out is not None and not isinstance(cache, Memory):
        RunRecord.of(plans, out, started).write(cache)
    results, controls = Results(cache), Controls()
    sweep = Sweep(results, explainers, workers, parallel_episodes, progress)
    settled = sweep.compute(piece for plan in plans for piece in plan)
    complete = _complete(plans, sweep.unsettled, settled)
    for k in ordered((k, k) for k in complete) if in_order else complete:
        plan = plans[k]
        error = next((sweep.errors[piece.key] for piece in plan if piece.key in sweep.errors), None)
        if error is not None:
            yield Failed(plan.request, error)
            continue
        yield entry_of(plan, results, controls, started, workers.jobs or 1, submitter)


def _complete(plans: Sequence[Plan], unsettled: Collection[str], settled: Iterable[Piece]) -> Iterator[int]:
    """Numbers of the plans, each once its last unsettled piece is settled."""
    waiting = [set(plan.piece_keys).intersection(unsettled) for plan in plans]
    users: dict[str, list[int]] = {}
    for k, keys in enumerate(waiting):
        for key in keys:
            users.setdefault(key, []).append(k)
    yield from (k for k, keys in enumerate(waiting) if not keys)
    for piece in settled:
        for k in users.pop(piece.key, ()):
            waiting[k].remove(piece.key)
            if not waiting[k]:
                yield k


def entries_of(outcomes: Iterable[Entry | Failed]) -> Iterator[Entry]:
    """The entries. Raises InputError with the error of the first that failed."""
    for outcome in outcomes:
        if isinstance(outcome, Failed):
            raise InputError(outcome.error)
        yield outcome


def _by_name(requests: Sequence[Request]) -> dict[str, Explainer]:
    """Explainers by name. Raises InputError if two share a name, because files of entries are named by it."""
    explainers: dict[str, Explainer] = {}
    for request in requests:
        explainer = request.explainer
        if explainers.setdefault(explainer.name, explainer) != explainer:
            raise InputError(f"two explainers are named {explainer.name!r}: rename one.")
    return explainers
