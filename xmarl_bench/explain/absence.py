"""Absence models: what replaces a removed message.

Explanations are judged by removing messages, and a removed message may be replaced by nothing or by another
one. No choice is the right one, so budgeted fidelity is measured under each. With coefficients a_ij and
messages v_j = W x_j, agent i receives sum_j m_ij a_ij v_j. The models replace what the mask m removes by

    zero          nothing: the paper's model, used by all of its metrics;
    mean          sum_j (1 - m_ij) a_ij (mean of v_j over reference states);
    resample      sum_j (1 - m_ij) a_ij v'_j, v' the messages of a random reference state; the effects of
                  DRAWS draws are averaged;
    renormalised  nothing, and the coefficients of the messages kept sum to 1 again, as if removed edges were
                  not in the softmax.

The coefficients a_ij stay those of the original messages, not of their replacements. Reference states are
those that explainers are fitted on, from episodes that no score plays.

All models but zero need a GraphPolicy, whose coefficients and messages are known. Every agent's own edge is
kept.
S is the number of timesteps, N agents, D observation entries, W the width of a message, Q reference states.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.explain.oracle import binary_rows, change_from_last, check_oracle, chunks
from xmarl_bench.metrics import prediction_change
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import GraphPolicy, Policy
from xmarl_bench.policy.distribution import ActionDistribution
from xmarl_bench.policy.network import Prepared

DRAWS: Final = 4  # per timestep


def message_rows(n_agents: int) -> Tensor:
    """(2^(N - 1), N, N) masks: row i of mask r keeps agent i's own edge and the others in the bits of r."""
    rows = binary_rows(n_agents - 1)
    masks = torch.ones(len(rows), n_agents, n_agents)
    masks[:, ~torch.eye(n_agents, dtype=torch.bool)] = rows.repeat(1, n_agents)
    return masks


def message_table(
    policy: GraphPolicy,
    observations: Tensor,
    absence: Absence,
    reference: Tensor,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """(S, N, D) -> (2^(N - 1), S, N): d_i of every row over the others, under one absence model.

    reference: (Q, N, D) observations whose messages replace removed ones. The rows are those of
    `others_table`. Raises InputError if the team has too many rows to try.
    """
    n_steps, n_agents, _ = observations.shape
    check_oracle(policy, n_agents)
    rows = message_rows(n_agents)[:, None]
    change = np.empty((len(rows), n_steps, n_agents))
    with torch.no_grad():
        replaced = list(stand_ins(absence, policy.prepare(reference).message, (DRAWS, n_steps), rng))
        for steps in chunks(n_steps, n_agents, len(rows)):
            prepared = policy.prepare(observations[steps])
            masks = rows.expand(-1, len(prepared.attention), -1, -1)
            tables = [
                step_under(policy, prepared, masks, absence, None if each is None else each[steps])[0]
                for each in replaced
            ]
            change[:, steps] = np.mean([change_from_last(table) for table in tables], axis=0)
    return change


def stand_ins(
    absence: Absence, messages: Tensor, draws: tuple[int, int], rng: np.random.Generator
) -> Iterator[Tensor | None]:
    """(S, N, W) replacements, one for each effect that is averaged; None: nothing.

    messages: (Q, N, W) of the reference states. draws: (K, S), K draws for each of S timesteps.
    """
    if absence in (Absence.ZERO, Absence.RENORMALISED):
        yield None
    elif absence is Absence.MEAN:
        yield messages.mean(dim=0).expand(draws[1], -1, -1)
    else:
        for drawn in rng.integers(len(messages), size=draws):
            yield messages[torch.from_numpy(drawn)]


def step_under(
    policy: GraphPolicy, prepared: Prepared, mask: Tensor, absence: Absence, stand_in: Tensor | None
) -> tuple[ActionDistribution, Tensor]:
    """F(m) under an absence model, and what agents remember at the next timestep.

    mask: (..., S, N, N), own edges kept. stand_in: (S, N, W) of `stand_ins`.
    """
    if absence is Absence.RENORMALISED:
        heard = (mask * prepared.attention).sum(dim=-1, keepdim=True)
        mask = mask / heard.clamp_min(torch.finfo(heard.dtype).tiny)
    return policy.decode_step(prepared, mask, stand_in)


class Removal:
    """Removes messages from a stretch of states under one absence model, by any masks.

    observations: (S, N, D). replaced: of `stand_ins`, for these timesteps. All absence models but zero need a
    GraphPolicy.
    """

    @torch.no_grad()
    def __init__(
        self, policy: Policy, observations: Tensor, absence: Absence, replaced: tuple[Tensor | None, ...]
    ) -> None:
        n_steps, n_agents, _ = observations.shape
        self.policy, self.absence, self.replaced = policy, absence, replaced
        self.prepared, ones = policy.prepare(observations), torch.ones(n_steps, n_agents, n_agents)
        self.full = [self._under(ones, each) for each in replaced]  # F(1), for each effect that is averaged

    @torch.no_grad()
    def change(self, mask: Tensor) -> NDArray[np.float64]:
        """(..., S, N, N) in [0, 1] -> (..., S, N): d_i."""
        changes = []
        for full, each in zip(self.full, self.replaced, strict=True):
            heard = self._under(mask, each)
            changes.append(prediction_change(full.action.numpy(), heard.action.numpy(), full.divisor))
        return np.asarray(np.mean(changes, axis=0))

    def _under(self, mask: Tensor, stand_in: Tensor | None) -> ActionDistribution:
        if isinstance(self.policy, GraphPolicy):
            return step_under(self.policy, self.prepared, mask, self.absence, stand_in)[0]
        return self.policy.decode(self.prepared, mask)
