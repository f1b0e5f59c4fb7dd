"""Tests, on random observations, that masks can explain a network, before it becomes a policy.

The network must accept any number of teams in a batch, compute each team independently and deterministically,
and pass one message for each edge. xmarl_bench.policy.interventions then tests its masks.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from xmarl_bench.errors import InputError, a_type, failures_named
from xmarl_bench.policy.interventions import SAME
from xmarl_bench.policy.messages import Call, followed
from xmarl_bench.policy.recurrent import call, initial_state, is_recurrent

REPEATED = 1e-6  # largest difference between two calls: threads may sum in another order


class Trial:
    """Runs a network on two teams' observations (2, N, D), with each team's edges and with both together.

    A network with memory runs on its memory after a first step.
    """

    def __init__(
        self, network: nn.Module, teams: Tensor, edges: tuple[Tensor, Tensor], together: Tensor
    ) -> None:
        self.network, self.name = network, type(network).__name__
        start, again = (initial_state(network, teams.shape[1]) for _ in range(2))
        if not torch.equal(start, again):
            raise InputError(f"{self.name} draws random numbers in initial_state: begin all episodes alike.")
        self.obs_dim, self.memory_dim = teams.shape[-1], start.shape[-1]
        self.teams = torch.cat([teams, start.expand(2, -1, -1)], dim=-1)
        self.edges, self.together = edges, together
        self.calls: list[Call] = []  # of the last run

    def check(self, width: int, holds: str) -> int:
        """How often the network passes messages. Raises InputError if masks cannot explain it.

        width: number of outputs for each agent, described by `holds`.
        """
        first = self._alone(0)
        n_calls = len(self.calls)
        if n_calls == 0:
            raise InputError(
                f"{self.name} passes no message through a layer of torch_geometric, so masks have nothing to "
                f"scale: let agents interact in MessagePassing layers, not in dense attention or row sums."
            )
        expected = (self.teams.shape[1], width)
        output = first[..., : first.shape[-1] - self.memory_dim] if isinstance(first, Tensor) else first
        if not isinstance(output, Tensor) or tuple(output.shape) != expected:
            is_tensor = isinstance(output, Tensor)
            got = f"shape {tuple(output.shape)}" if is_tensor else a_type(output)
            raise InputError(
                f"{self.name} returned {got} for {expected[0]} agents: return {expected}, {holds}."
            )
        if first.dtype != self.teams.dtype:
            raise InputError(
                f"{self.name} returned {first.dtype} for {self.teams.dtype}: keep the dtype of observations."
            )
        if self.memory_dim:
            remembered = torch.stack([self._alone(0), self._alone(1)])[..., width:]
            self.teams = torch.cat([self.teams[..., : self.obs_dim], remembered], dim=-1)
            first = self._alone(0)
        if not bool(torch.isfinite(first).all()):
            raise InputError(
                f"{self.name} returned NaN or infinity for random observations: look for a division by zero "
                f"or an overflow."
            )
        self._check_repeats(first)
        both = self._run(self.teams.flatten(0, 1), self.together)
        if both.shape != (2 * len(first), *first.shape[1:]):
            raise InputError(
                f"{self.name} returned shape {tuple(both.shape)} for two teams of {len(first)} agents: "
                f"return a row for each agent."
            )
        beside = both[: len(first)]
        if not torch.allclose(beside, first, rtol=SAME, atol=SAME):
            raise InputError(
                f"{self.name} mixes the graphs of a batch: let agents interact in message-passing layers "
                f"only."
            )
        return n_calls

    def _check_repeats(self, first: Tensor) -> None:
        """Distinguish random numbers, which repeat with torch's seed, from a state kept between calls."""
        self._alone(1)
        if _repeats(self._alone(0), first):
            return
        here = self._seeded()
        self._alone(1)
        if _repeats(self._seeded(), here):
            raise InputError(
                f"{self.name} draws random numbers: remove noise, and dropout that stays on after training."
            )
        raise InputError(
            f"{self.name} keeps a state between calls, or draws random numbers of its own: return the same "
            f"output for the same observations, and declare a memory with initial_state and step."
        )

    def _seeded(self) -> Tensor:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            return self._alone(0)

    def _alone(self, team: int) -> Tensor:
        return self._run(self.teams[team], self.edges[team])

    def _run(self, x: Tensor, edge_index: Tensor) -> Tensor:
        method, state = ("step", ", state") if is_recurrent(self.network) else ("forward", "")
        remedy = (
            f"make its {method} take (x (n, {self.obs_dim}), edge_index (2, edges){state}), of one team of "
            f"{self.teams.shape[1]} or of many"
        )
        with (
            failures_named(f"{self.name} failed on {len(x)} agents", remedy),
            torch.no_grad(),
            followed(self.network, edge_index, len(x)) as self.calls,
        ):
            return call(self.network, x, edge_index.clone())


def _repeats(again: Tensor, first: Tensor) -> bool:
    return torch.allclose(again, first, rtol=REPEATED, atol=REPEATED)
