"""Networks with memory: what they declare, and how the harness runs them.

A state is a tensor (n, h), a row for each agent, or a tuple of such tensors, as the (h, c) of an LSTM. The
harness keeps it: an episode records it as H more entries of each agent's observation, after those of the
task. So every recorded timestep is explained from the team's state at that timestep, and explainers and
metrics need no special case.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeGuard

import torch
from torch import Tensor, nn

from xmarl_bench.errors import InputError, a_type, failures_named

State = Tensor | tuple[Tensor, ...]


class RecurrentNetwork(Protocol):
    """The methods of a network with memory, instead of `forward`. n agents, of one team or of many."""

    def initial_state(self, n: int) -> State:
        """A row for each agent, before the first timestep of an episode."""

    def step(self, x: Tensor, edge_index: Tensor, state: Any) -> tuple[Tensor, State]:
        """(n, D), (2, edges), the state -> (n, W) output, the next state, of the same shapes."""


def is_recurrent(network: object) -> TypeGuard[RecurrentNetwork]:
    """Whether the network declares a memory."""
    return all(callable(getattr(network, name, None)) for name in ("initial_state", "step"))


def initial_state(network: nn.Module, n: int) -> Tensor:
    """(n, H); H is 0 if the network is not recurrent. Raises InputError if its state is invalid."""
    if not is_recurrent(network):
        return torch.zeros(n, 0)
    what = f"initial_state of {type(network).__name__} failed"
    with failures_named(what, "make it take the number of agents"), torch.no_grad():
        state = network.initial_state(n)
    return torch.cat(_parts(network, "initial_state", state, n), dim=1).detach()


def run(network: nn.Module, x: Tensor, edge_index: Tensor) -> Tensor:
    """(n, D + H), (2, edges) -> (n, W + H): the network's output of width W, then the next memory.

    Raises InputError if the network fails, or does not return a row for each agent.
    """
    name = type(network).__name__
    with failures_named(f"{name} failed on {len(x)} agents", "correct the network"):
        output = call(network, x, edge_index)
    if not isinstance(output, Tensor) or output.dim() != 2 or len(output) != len(x):
        got = f"shape {tuple(output.shape)}" if isinstance(output, Tensor) else a_type(output)
        raise InputError(f"{name} returned {got} for {len(x)} agents: return a row for each agent.")
    return output


def call(network: nn.Module, x: Tensor, edge_index: Tensor) -> Tensor:
    """The same as `run`, with the network's own errors, and whatever it returns if it is not recurrent.

    The network gets a copy: one that changes its input in place changes no recorded observation.
    """
    x = x.clone()
    if not is_recurrent(network):
        plain: Tensor = network(x, edge_index)
        return plain
    start = network.initial_state(len(x))
    widths = [part.shape[1] for part in _parts(network, "initial_state", start, len(x))]
    seen, *state = x.split([x.shape[1] - sum(widths), *widths], dim=1)
    returned = network.step(seen, edge_index, state[0] if isinstance(start, Tensor) else tuple(state))
    output, after = returned if isinstance(returned, tuple) and len(returned) == 2 else (None, None)
    if not (isinstance(output, Tensor) and output.dim() == 2 and len(output) == len(x)):
        raise InputError(
            f"step of {type(network).__name__} did not return an output ({len(x)}, width) and the next "
            f"state: return this pair."
        )
    parts = _parts(network, "step", after, len(x))
    if [part.shape[1] for part in parts] != widths:
        raise InputError(
            f"step of {type(network).__name__} returned a state of widths "
            f"{[part.shape[1] for part in parts]}, but initial_state of {widths}: return the same widths."
        )
    return torch.cat([output, *parts], dim=1)


def _parts(network: object, method: str, state: Any, n: int) -> list[Tensor]:
    """The tensors (n, h) of a state."""
    parts = list(state) if isinstance(state, tuple) else [state]
    for part in parts:
        if not (isinstance(part, Tensor) and part.is_floating_point() and part.dim() == 2 and len(part) == n):
            is_tensor = isinstance(part, Tensor)
            got = f"{tuple(part.shape)} of {part.dtype}" if is_tensor else a_type(part)
            raise InputError(
                f"{method} of {type(network).__name__} returned {got} as a state of {n} agents: return "
                f"floating-point numbers ({n}, h), or a tuple of such."
            )
    return parts
