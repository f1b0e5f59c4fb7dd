"""What an explainer is, and the one way the harness runs it.

S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, TypeVar

import torch
from torch import Tensor

from xmarl_bench.black_box import BlackBox
from xmarl_bench.effect import signed_to_unit
from xmarl_bench.errors import InputError
from xmarl_bench.policy import Policy
from xmarl_bench.pyg import class_settings_kept
from xmarl_bench.reproducible import seeded

Scalar = bool | int | float | str | None
Access = Literal["black-box", "attention", "gradients"]
Result = TypeVar("Result")


class Explain(Protocol):
    """Says how much each message matters."""

    def __call__(self, policy: Policy, observations: Tensor, generator: torch.Generator, /) -> Tensor:
        """(S, N, D) float32 observations of one episode -> mask (S, N, N) in [0, 1].

        mask[s, i, j] is how much edge j -> i (sender j, receiver i; the diagonal is the agent's own edge)
        matters at timestep s. `policy` is a private copy; all randomness comes out of `generator`.
        """


# (policy, observations (S, N, D) that no score uses, generator) -> what explains this policy.
Fit = Callable[[Policy, Tensor, torch.Generator], Explain]


@dataclass(frozen=True)
class Explainer:
    """An explainer as the benchmark knows it: the callable, and what it declares of itself.

    An entry records the declarations and the harness acts on them. Third parties register one, or whatever
    else `as_explainer` takes, under the entry-point group `xmarl_bench.explainers`, by the same name.
    """

    name: str
    explain: Explain
    summary: str = ""  # one line for people
    stochastic: bool = False  # another seed gives another mask
    slow: bool = False  # more than about 10 ms per timestep: gets fewer episodes where a run says so
    control: bool = False  # not an explanation but a floor or ceiling to read the others by
    hyperparameters: Mapping[str, Scalar] = field(default_factory=dict)
    batched: bool = True  # False: `explain` is called for one timestep at a time, (N, D) -> (N, N)
    binary: bool = False  # masks of zeros and ones, refused otherwise
    signed: bool = False  # finite numbers of either sign, brought to [0, 1] by `signed_to_unit`
    # What it asks of the policy: "black-box" gets one that only answers (xmarl_bench.black_box), "attention"
    # one that tells its attention too; "gradients", and None for not said, the network itself.
    accesses: Access | None = None
    fit: Fit | None = None  # learns from states that no score uses, once per policy; gives what explains it
    fitted_on: Tensor | None = field(default=None, compare=False, repr=False)  # (S, N, D)


def run_explainer(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> Tensor:
    """(S, N, D) -> (S, N, N): the checked mask of one episode, a function of its arguments alone.

    The explainer sees copies, so the policy cannot be touched. The global random states of torch, numpy and
    Python are seeded, for explainers that ignore their generator, and put back afterwards, and so is what
    PyG's algorithms keep on their class. Raises InputError, naming the explainer, for whatever goes wrong
    inside it.
    """
    if explainer.fit is not None and explainer.fitted_on is None:
        raise InputError(f"explainer {explainer.name!r} has to be fitted first: see `fit_explainer`.")
    n_steps, n_agents, _ = observations.shape
    name, explain = explainer.name, explainer.explain

    def run(generator: torch.Generator) -> object:
        if explainer.batched:
            return explain(_shown(explainer, policy), observations.clone(), generator)
        seeds = torch.randint(2**62, (n_steps,), generator=generator).tolist()
        masks: list[Tensor] = []
        for x, each in zip(observations, seeds, strict=True):
            mask = explain(_shown(explainer, policy), x.clone(), torch.Generator().manual_seed(each))
            masks.append(_as_numbers(name, mask, (n_agents, n_agents)))
        return torch.stack(masks)

    mask = _guarded(explainer, seed, f"observations of shape {tuple(observations.shape)}", run)
    if explainer.signed:
        mask = signed_to_unit(_as_numbers(name, mask, (n_steps, n_agents, n_agents)))
    checked = checked_mask(name, mask, n_steps, n_agents)
    if explainer.binary and bool(((checked != 0) & (checked != 1)).any()):
        raise InputError(
            f"explainer {name!r} declares binary masks and returned other values than 0 and 1: round them, "
            f"or leave `binary` out."
        )
    adjacency = policy.adjacency(observations)
    return checked if adjacency is None else checked * adjacency  # edges that are not there matter to nobody


def fit_explainer(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> Explainer:
    """The explainer fitted to `policy` on observations (S, N, D), itself where it needs no fitting.

    Runs as `run_explainer` does, on copies. Raises InputError, naming the explainer.
    """
    fit = explainer.fit
    if fit is None:
        return explainer
    fitted = _guarded(
        explainer,
        seed,
        f"{len(observations)} timesteps to be fitted on",
        lambda generator: fit(_shown(explainer, policy), observations.clone(), generator),
    )
    return replace(explainer, explain=fitted, fitted_on=observations)


def checked_mask(name: str, mask: object, n_steps: int, n_agents: int) -> Tensor:
    """The mask as a detached float32 tensor (S, N, N). Raises InputError naming the explainer.

    Nothing is clipped, filled or reshaped: a mask that is not one is refused.
    """
    numbers = _as_numbers(name, mask, (n_steps, n_agents, n_agents))
    low, high = float(numbers.min()), float(numbers.max())
    if low < 0.0 or high > 1.0:
        raise InputError(
            f"explainer {name!r} returned mask values from {low:.6g} to {high:.6g}: scale them to [0, 1]."
        )
    return numbers.to(dtype=torch.float32, copy=True)


def _as_numbers(name: str, mask: object, expected: tuple[int, ...]) -> Tensor:
    """A tensor of finite floating-point numbers of the shape expected, detached."""
    if not isinstance(mask, Tensor):
        raise InputError(
            f"explainer {name!r} returned a {type(mask).__name__}: return a torch.Tensor of shape {expected}."
        )
    if tuple(mask.shape) != expected:
        raise InputError(
            f"explainer {name!r} returned a mask of shape {tuple(mask.shape)}, expected {expected}."
        )
    if not mask.is_floating_point():
        raise InputError(
            f"explainer {name!r} returned a mask of {mask.dtype}: return floating-point numbers."
        )
    mask = mask.detach()
    n_bad = int((~torch.isfinite(mask)).sum())
    if n_bad:
        raise InputError(
            f"explainer {name!r} returned NaN or infinity in {n_bad} of {mask.numel()} mask values: "
            f"return finite numbers in [0, 1]."
        )
    return mask


def _shown(explainer: Explainer, policy: Policy) -> Policy:
    """What the explainer sees of the policy: a copy, or one that only answers."""
    private = copy.deepcopy(policy)
    if explainer.accesses in ("black-box", "attention"):
        return BlackBox(private, attention=explainer.accesses == "attention")
    return private


def _guarded(explainer: Explainer, seed: int, what: str, run: Callable[[torch.Generator], Result]) -> Result:
    """Call with everything that is global seeded and put back; errors name the explainer."""
    with seeded(seed), class_settings_kept(), torch.inference_mode(False), torch.enable_grad():
        try:
            return run(torch.Generator().manual_seed(seed))
        except InputError:
            raise
        except Exception as error:
            reason = f"{type(error).__name__}: {error}".rstrip(". \n")
            raise InputError(
                f"explainer {explainer.name!r} failed on {what} ({reason}): correct it, or leave it out."
            ) from error
