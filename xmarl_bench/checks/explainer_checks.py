"""Checks of an explainer: its masks are valid and repeatable, and it has no side effects.

Scoring is protected from faulty explainers (by copies, seeds and checked masks); these checks tell the author
about the faults. S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

import torch
from torch import Tensor

from xmarl_bench.checks.degenerate_checks import DEGENERATE_CHECKS
from xmarl_bench.checks.explainer_subject import SEED, ExplainerSubject
from xmarl_bench.checks.findings import Failed, Finding, NotApplicable, run_checks
from xmarl_bench.checks.peak_memory import peak_memory
from xmarl_bench.checks.traces import global_settings, random_states, traces_of
from xmarl_bench.counted import counted
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer, explain_of, fitted, run_explainer, seen
from xmarl_bench.explain.returned_mask import as_floats, finite
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.parallel.fan_out import in_order
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.policy import Policy
from xmarl_bench.reproducible import one_thread, seeded
from xmarl_bench.rollout.cell import Cell, spaced_timesteps
from xmarl_bench.rollout.reference_states import FIRST_FIT_SEED, FIT_EPISODES, fit_states

ROUNDING: Final = 1e-4  # rounding of matrix products depends on the size of the batch
SLOW_MS: Final = 20.0  # CPU time per timestep: twice the limit of `slow`, because machines differ
MAX_MEMORY_MB: Final = 2000.0
TIMED_TIMESTEPS: Final = 100  # enough to share the fixed cost of a batch
MEMORY_TIMESTEPS: Final = 500


def check_explainer(
    explainer: Explainer, policy: Policy, task: str, n_agents: int, timesteps: int
) -> Iterator[Finding]:
    """Run every check on at most that many states of the policy's own episodes.

    Raises InputError if the explainer cannot be fitted.
    """
    with one_thread():
        # One that simulates is given the simulator of one episode, and the states of no other.
        played = fit_states(policy, Cell(task, n_agents), episodes=1 if explainer.simulates else FIT_EPISODES)
        states = played[torch.from_numpy(spaced_timesteps(len(played), timesteps))]
        ready = fitted(explainer, policy, lambda: played, SEED)
        ready = replace(ready, simulator=Simulator(task, n_agents, FIRST_FIT_SEED))
        yield from run_checks(CHECKS, ExplainerSubject(ready, policy, states))


def shape(subject: ExplainerSubject) -> str:
    n_steps, n_agents, _ = subject.observations.shape
    floats = as_floats(subject.explainer.name, subject.returned, (n_steps, n_agents, n_agents))
    return f"{tuple(floats.shape)} of {floats.dtype}"


def finiteness(subject: ExplainerSubject) -> str:
    finite(subject.explainer.name, _floats(subject))
    return ""


def range_(subject: ExplainerSubject) -> str:
    try:
        finite(subject.explainer.name, _floats(subject))
    except InputError:
        raise NotApplicable("needs finite numbers.") from None
    mask = subject.mask
    return f"{float(mask.min()):.3g} to {float(mask.max()):.3g}" + (
        ", normalised by the harness" if subject.explainer.signed else ""
    )


def same_seed(subject: ExplainerSubject) -> str:
    first = subject.mask_or_skip()
    second = subject.explain(subject.observations)
    if not torch.equal(first, second):
        raise Failed(
            f"two runs with one seed differ by up to {_gap(first, second):.3g}: draw random numbers from "
            f"`generator`, and keep no state between calls."
        )
    return ""


def another_seed(subject: ExplainerSubject) -> str:
    first = subject.mask_or_skip()
    gap = _gap(first, subject.explain(subject.observations, SEED + 1))
    if gap and not subject.explainer.stochastic:
        raise Failed(f"another seed changes the mask by up to {gap:.3g}: declare stochastic = True.")
    return f"declared stochastic, masks differ by up to {gap:.3g}" if subject.explainer.stochastic else ""


def another_process(subject: ExplainerSubject) -> str:
    first = subject.mask_or_skip()
    work = subject.explainer, subject.policy, subject.observations
    try:
        (second,) = in_order(_one_thread, [work], workers=Workers(2))
    except InputError:
        raise
    except Exception as error:
        raise Failed(
            f"it cannot be sent to a worker process ({type(error).__name__}: {error}): remove what "
            f"cannot be pickled."
        ) from error
    if not torch.equal(first, second):
        raise Failed(
            f"the mask differs in another process, by up to {_gap(first, second):.3g}: compute it from "
            f"policy, observations and generator alone."
        )
    return ""


def policy_untouched(subject: ExplainerSubject) -> str:
    subject.mask_or_skip()
    policy = copy.deepcopy(subject.policy)
    before = traces_of(policy, subject.observations)
    _call(subject, policy, subject.observations.clone())
    after = traces_of(policy, subject.observations)
    changed = [what for what in before if before[what] != after[what]]
    if changed:
        raise Failed(f"it changed the policy's {', '.join(changed)}: work on a copy.")
    return ""


def observations_untouched(subject: ExplainerSubject) -> str:
    subject.mask_or_skip()
    given = subject.observations.clone()
    _call(subject, copy.deepcopy(subject.policy), given)
    if not torch.equal(given, subject.observations):
        raise Failed("it wrote into the observations: work on a copy.")
    return ""


def random_state_untouched(subject: ExplainerSubject) -> str:
    subject.mask_or_skip()
    policy, observations = copy.deepcopy(subject.policy), subject.observations.clone()
    with seeded(SEED), one_thread():
        before, settings = random_states(), global_settings()
        _call(subject, policy, observations)
        drawn = [name for name, state in random_states().items() if state != before[name]]
        changed = [name for name, value in global_settings().items() if value != settings[name]]
    if drawn:
        raise Failed(f"it changed the global random state of {', '.join(drawn)}: draw from `generator`.")
    if changed:
        raise Failed(f"it changed {', '.join(changed)} for the whole process: restore the old value.")
    return ""


def batch_order(subject: ExplainerSubject) -> str:
    mask = _deterministic(subject)
    order = torch.randperm(len(mask), generator=torch.Generator().manual_seed(SEED))
    return _same_but_rounding(mask[order], subject.explain(subject.observations[order]), "in another order")


def chunk(subject: ExplainerSubject) -> str:
    mask = _deterministic(subject)
    middle = len(mask) // 2
    if not middle:
        raise NotApplicable("needs two timesteps.")
    halves = [subject.explain(part) for part in subject.observations.split([middle, len(mask) - middle])]
    return _same_but_rounding(mask, torch.cat(halves), "in two halves")


def team_sizes(subject: ExplainerSubject) -> str:
    """`explain` checks the masks."""
    subject.mask_or_skip()
    own, obs_dim = subject.observations.shape[1:]
    if subject.explainer.fit is not None:
        raise NotApplicable(f"it was fitted on teams of {own}.")
    if subject.explainer.simulates:
        raise NotApplicable(f"its simulator is that of a team of {own}.")
    generator = torch.Generator().manual_seed(SEED)
    sizes = [n for n in (1, 2, 5) if n != own]
    for n in sizes:
        x = torch.randn(2, n, obs_dim, generator=generator)
        try:
            subject.policy.distribution(x)
        except InputError as error:
            raise NotApplicable(str(error)) from None
        subject.explain(x)
    return f"{own}, " + ", ".join(map(str, sizes))


def time_per_timestep(subject: ExplainerSubject) -> str:
    subject.mask_or_skip()
    x = _at_least(subject, TIMED_TIMESTEPS)
    n_steps = len(x)
    started = time.process_time()
    subject.explain(x)
    each = (time.process_time() - started) * 1000 / n_steps
    measured = f"{each:.3g} ms of CPU, over {counted(n_steps, 'timestep')}"
    if each > SLOW_MS and not subject.explainer.slow:
        raise Failed(f"{measured}, without being declared slow: declare slow = True.")
    return measured


def memory(subject: ExplainerSubject) -> str:
    subject.mask_or_skip()
    x = _at_least(subject, MEMORY_TIMESTEPS)
    megabytes = peak_memory(lambda: subject.explain(x))
    if megabytes is None:
        raise NotApplicable("this system does not report a process's peak memory.")
    measured = f"{megabytes:.0f} MB more at its peak, on {counted(len(x), 'timestep')}"
    if megabytes > MAX_MEMORY_MB:
        raise Failed(f"{measured}, over {MAX_MEMORY_MB:.0f}: explain fewer timesteps at once.")
    return measured


CHECKS: dict[str, Callable[[ExplainerSubject], str]] = {
    "shape": shape,
    "finiteness": finiteness,
    "range": range_,
    "same seed, same mask": same_seed,
    "another seed": another_seed,
    "another process, same mask": another_process,
    "policy untouched": policy_untouched,
    "observations untouched": observations_untouched,
    "global random state untouched": random_state_untouched,
    "order of timesteps": batch_order,
    "chunks of timesteps": chunk,
    **DEGENERATE_CHECKS,
    "other team sizes": team_sizes,
    "time per timestep": time_per_timestep,
    "memory": memory,
}


def _floats(subject: ExplainerSubject) -> Tensor:
    n_steps, n_agents, _ = subject.observations.shape
    try:
        return as_floats(subject.explainer.name, subject.returned, (n_steps, n_agents, n_agents))
    except InputError:
        raise NotApplicable("the explainer returned no valid mask.") from None


def _at_least(subject: ExplainerSubject, n_steps: int) -> Tensor:
    """The states, repeated up to `n_steps` or more; once if the explainer is declared slow."""
    n_states = len(subject.observations)
    times = 1 if subject.explainer.slow else -(-n_steps // n_states)
    return subject.observations.repeat(times, 1, 1)


def _call(subject: ExplainerSubject, policy: Policy, observations: Tensor) -> None:
    """Call the explainer without scoring's protection: on this policy object and the global random state."""
    explainer, generator = subject.explainer, torch.Generator().manual_seed(SEED)
    with torch.enable_grad():
        for x in [observations] if explainer.batched else observations:
            explain_of(explainer)(seen(explainer, policy), x, generator)


def _one_thread(work: tuple[Explainer, Policy, Tensor]) -> Tensor:
    explainer, policy, observations = work
    with one_thread():
        return run_explainer(explainer, policy, observations.clone(), SEED)


def _deterministic(subject: ExplainerSubject) -> Tensor:
    mask = subject.mask_or_skip()
    if subject.explainer.stochastic:
        raise NotApplicable("a stochastic explainer draws its random numbers in the order of timesteps.")
    return mask


def _same_but_rounding(expected: Tensor, mask: Tensor, how: str) -> str:
    """Rounding may move a value across an explainer's threshold, so one value in a hundred may change."""
    changed = float(((expected - mask).abs() > ROUNDING).double().mean())
    if changed > 0.01:
        raise Failed(
            f"explained {how}, {changed:.0%} of the values change, by up to {_gap(expected, mask):.3g}: "
            f"explain each timestep independently."
        )
    return f"largest difference {_gap(expected, mask):.2g}"


def _gap(one: Tensor, other: Tensor) -> float:
    return float((one - other).abs().max())
