"""What an explainer is, and the one way the harness runs it.

S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.policy import Policy
from xmarl_bench.pyg import class_settings_kept
from xmarl_bench.reproducible import seeded

Scalar = bool | int | float | str | None


class Explain(Protocol):
    """Says how much each message matters."""

    def __call__(self, policy: Policy, observations: Tensor, generator: torch.Generator, /) -> Tensor:
        """(S, N, D) float32 observations of one episode -> mask (S, N, N) in [0, 1].

        mask[s, i, j] is how much edge j -> i (sender j, receiver i; the diagonal is the agent's own edge)
        matters at timestep s. `policy` is a private copy; all randomness comes out of `generator`.
        """


@dataclass(frozen=True)
class Explainer:
    """An explainer as the benchmark knows it: the callable, and what an entry records of it.

    Third parties register one under the entry-point group `xmarl_bench.explainers`, by the same name.
    """

    name: str
    explain: Explain
    summary: str = ""  # one line for people
    stochastic: bool = False  # another seed gives another mask
    slow: bool = False  # more than about 10 ms per timestep: gets fewer episodes where a run says so
    control: bool = False  # not an explanation but a floor or ceiling to read the others by
    hyperparameters: Mapping[str, Scalar] = field(default_factory=dict)


def run_explainer(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> Tensor:
    """(S, N, D) -> (S, N, N): the checked mask of one episode, a function of its arguments alone.

    The explainer sees copies, so the policy cannot be touched. The global random states of torch, numpy and
    Python are seeded, for explainers that ignore their generator, and put back afterwards, and so is what
    PyG's algorithms keep on their class. Raises InputError, naming the explainer, for whatever goes wrong
    inside it.
    """
    with seeded(seed), class_settings_kept(), torch.inference_mode(False), torch.enable_grad():
        generator = torch.Generator().manual_seed(seed)
        try:
            mask = explainer.explain(copy.deepcopy(policy), observations.clone(), generator)
        except InputError:
            raise
        except Exception as error:
            what = f"{type(error).__name__}: {error}".rstrip(". \n")
            raise InputError(
                f"explainer {explainer.name!r} failed on observations of shape "
                f"{tuple(observations.shape)} ({what}): correct it, or leave it out."
            ) from error
    n_steps, n_agents, _ = observations.shape
    return checked_mask(explainer.name, mask, n_steps, n_agents)


def checked_mask(name: str, mask: object, n_steps: int, n_agents: int) -> Tensor:
    """The mask as a detached float32 tensor (S, N, N). Raises InputError naming the explainer.

    Nothing is clipped, filled or reshaped: a mask that is not one is refused.
    """
    expected = (n_steps, n_agents, n_agents)
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
    low, high = float(mask.min()), float(mask.max())
    if low < 0.0 or high > 1.0:
        raise InputError(
            f"explainer {name!r} returned mask values from {low:.6g} to {high:.6g}: scale them to [0, 1]."
        )
    return mask.to(dtype=torch.float32, copy=True)
