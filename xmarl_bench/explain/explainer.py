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

from xmarl_bench.errors import InputError
from xmarl_bench.explain.effect import signed_to_unit
from xmarl_bench.explain.pyg import class_settings_kept
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.origin.references import Origin
from xmarl_bench.policy import Policy
from xmarl_bench.policy.black_box import BlackBox
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
    # What it asks of the policy: "black-box" gets one that only answers (policy.black_box), "attention"
    # one that tells its attention too; "gradients", and None for not said, the network itself.
    accesses: Access | None = None
    # The absence model under which it takes messages away; None where it takes none away, or does not say.
    absence: Absence | None = None
    fit: Fit | None = None  # learns from states that no score uses, once per policy; gives what explains it
    fitted_on: Tensor | None = field(default=None, compare=False, repr=False)  # (S, N, D)
    # Set where it is found by name; None for an object that is handed over, see `origin_of_explainer`.
    origin: Origin | None = field(default=None, compare=False, repr=False)


def run_explainer(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> Tensor:
    """(S, N, D) -> (S, N, N): the checked mask of one episode, a function of its arguments alone.

    The explainer sees copies, so the policy cannot be touched. The global random states of torch, numpy and
    Python are seeded, for explainers that ignore their generator, and put back afterwards, and so is what
    PyG's algorithms keep on their class. Raises InputError, naming the explainer, for whatever goes wrong
    inside it.
    """
    n_steps, n_agents, _ = observations.shape
    returned = returned_by(explainer, policy, observations, seed)
    mask = mask_of_explainer(explainer, returned, n_steps, n_agents)
    adjacency = policy.adjacency(observations)
    return mask if adjacency is None else mask * adjacency  # edges that are not there matter to nobody


def returned_by(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> object:
    """As `run_explainer`, but what the explainer returned, whatever it is."""
    if explainer.fit is not None and explainer.fitted_on is None:
        raise InputError(f"explainer {explainer.name!r} has to be fitted first: see `fit_explainer`.")
    n_steps, n_agents, _ = observations.shape
    name, explain = explainer.name, explainer.explain

    def run(generator: torch.Generator) -> object:
        if explainer.batched:
            return explain(seen(explainer, copy.deepcopy(policy)), observations.clone(), generator)
        seeds = torch.randint(2**62, (n_steps,), generator=generator).tolist()
        masks: list[Tensor] = []
        for x, each in zip(observations, seeds, strict=True):
            private, drawn = copy.deepcopy(policy), torch.Generator().manual_seed(each)
            mask = explain(seen(explainer, private), x.clone(), drawn)
            masks.append(as_floats(name, mask, (n_agents, n_agents)))
        return torch.stack(masks)

    return _guarded(explainer, seed, f"observations of shape {tuple(observations.shape)}", run)


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
        lambda generator: fit(seen(explainer, copy.deepcopy(policy)), observations.clone(), generator),
    )
    return replace(explainer, explain=fitted, fitted_on=observations)


def seen(explainer: Explainer, policy: Policy) -> Policy:
    """What the explainer sees of a policy: all of it, or one that only answers."""
    if explainer.accesses in ("black-box", "attention"):
        return BlackBox(policy, attention=explainer.accesses == "attention")
    return policy


def mask_of_explainer(explainer: Explainer, mask: object, n_steps: int, n_agents: int) -> Tensor:
    """What the explainer returned, normalised if it is signed, as a checked mask (S, N, N)."""
    name = explainer.name
    if explainer.signed:
        mask = signed_to_unit(finite(name, as_floats(name, mask, (n_steps, n_agents, n_agents))))
    checked = checked_mask(name, mask, n_steps, n_agents)
    if explainer.binary and bool(((checked != 0) & (checked != 1)).any()):
        raise InputError(
            f"explainer {name!r} declares binary masks and returned other values than 0 and 1: round them, "
            f"or leave `binary` out."
        )
    return checked


def checked_mask(name: str, mask: object, n_steps: int, n_agents: int) -> Tensor:
    """The mask as a detached float32 tensor (S, N, N). Raises InputError naming the explainer.

    Nothing is clipped, filled or reshaped: a mask that is not one is refused.
    """
    numbers = finite(name, as_floats(name, mask, (n_steps, n_agents, n_agents)))
    low, high = float(numbers.min()), float(numbers.max())
    if low < 0.0 or high > 1.0:
        raise InputError(
            f"explainer {name!r} returned mask values from {low:.6g} to {high:.6g}: scale them to [0, 1]."
        )
    return numbers.to(dtype=torch.float32, copy=True)


def as_floats(name: str, mask: object, expected: tuple[int, ...]) -> Tensor:
    """A detached tensor of floating-point numbers of the shape expected. Raises InputError."""
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
    return mask.detach()


def finite(name: str, mask: Tensor) -> Tensor:
    """The mask, of finite numbers. Raises InputError."""
    n_bad = int((~torch.isfinite(mask)).sum())
    if n_bad:
        raise InputError(
            f"explainer {name!r} returned NaN or infinity in {n_bad} of {mask.numel()} mask values: "
            f"return finite numbers in [0, 1]."
        )
    return mask


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
