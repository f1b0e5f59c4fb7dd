"""A unit of the work of scoring: one episode, explained by some explainers and measured beside the controls.

Matrix products round differently in batches of another size and in memory of another alignment, so an
episode is always one batch of its own, in tensors that torch allocates: what an explainer scores on it
depends on nothing but (policy, explainer, seed, episode, timesteps), and not on the other explainers.
"""

from __future__ import annotations

import copy
import math
import time
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from xmarl_bench.entry.protocol import SANITY_TIMESTEPS
from xmarl_bench.entry.schema import BudgetRow, ExplanationRow, PolicyRow, SanityRow
from xmarl_bench.errors import InputError
from xmarl_bench.explain.controls import CONTROLS, ORACLE, SOFT_ORACLE
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.explain.oracle import ascend
from xmarl_bench.explain.sanity import seed_stability, weight_randomisation
from xmarl_bench.policy import Policy
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.rollout.cell import spaced_timesteps
from xmarl_bench.rollout.episodes import Episode
from xmarl_bench.scoring.states import States, number


@dataclass(frozen=True)
class Explained:
    """What one explainer scored on one episode."""

    row: ExplanationRow
    budgets: dict[str, BudgetRow]  # by their names in the row
    inverted: ExplanationRow  # of 1 - mask
    sanity: SanityRow | None  # None where the unit does not ask for it
    seconds: float  # for the masks alone


@dataclass(frozen=True)
class Shared:
    """What an episode gives whoever explains it."""

    timesteps: int  # explained
    controls: dict[str, ExplanationRow]  # no oracle where there is none
    policy: PolicyRow
    seconds: float  # for all but the explainers' masks and metrics


@dataclass(frozen=True)
class Measured:
    explained: dict[str, Explained | InputError]  # by explainer; the error of one does not stop the others
    shared: Shared | None  # None where it was not asked for


@dataclass(frozen=True)
class Unit:
    """One episode to explain and measure: what is handed to a worker."""

    policy: Policy
    explainers: tuple[Explainer, ...]
    episode: Episode
    seed: int  # of the run
    timesteps: int | None  # at most so many; None is all
    sanity: bool  # check stability between seeds and shuffled weights too
    reference: Tensor | None = None  # (Q, N, D): see xmarl_bench.explain.absence
    controls: tuple[Explainer, ...] = tuple(CONTROLS.values())
    shared: bool = True  # measure the controls and the policy too

    def run(self) -> Measured:
        with one_thread():
            # A copy is laid out as torch lays it out, also where the policy came through a pickle.
            policy = copy.deepcopy(self.policy).eval()
            chosen = spaced_timesteps(len(self.episode.observations), self.timesteps)
            observations = torch.tensor(self.episode.observations[chosen])
            started = time.perf_counter()
            rng = np.random.default_rng(derived_seed("states", self.seed, self.episode.seed))
            states = States.of(policy, observations, rng, self.reference)
            shared = self._shared(states, started) if self.shared else None
            explained = {each.name: self._explain(each, states) for each in self.explainers}
        return Measured(explained, shared)

    def _shared(self, states: States, started: float) -> Shared:
        controls = {name: states.mask_metrics(mask) for name, mask in self._control_masks(states).items()}
        policy = states.policy_metrics()
        return Shared(len(states.observations), controls, policy, time.perf_counter() - started)

    def _explain(self, explainer: Explainer, states: States) -> Explained | InputError:
        try:
            started = time.perf_counter()
            mask = self._mask(explainer, states)
            seconds = time.perf_counter() - started
            sanity = self._sanity(explainer, states, mask) if self.sanity else None
        except InputError as error:
            return error
        row, budgets, inverted = states.with_inverse(mask)
        return Explained(row, budgets, inverted, sanity, seconds)

    def _mask(self, explainer: Explainer, states: States) -> Tensor:
        seed = derived_seed("explainer", self.seed, explainer.name, self.episode.seed)
        return run_explainer(explainer, states.policy, states.observations, seed)

    def _sanity(self, explainer: Explainer, states: States, mask: Tensor) -> SanityRow:
        few = torch.from_numpy(spaced_timesteps(len(mask), SANITY_TIMESTEPS))
        subject = explainer, states.policy, states.observations[few], mask[few]
        seed = derived_seed("sanity", self.seed, explainer.name, self.episode.seed)
        randomised = weight_randomisation(*subject, seed)
        stability = seed_stability(*subject, seed) if explainer.stochastic else math.nan
        values = {"weight_randomisation": number(randomised), "seed_stability": number(stability)}
        return SanityRow.model_validate(values)

    def _control_masks(self, states: States) -> dict[str, Tensor]:
        """The masks of the controls; the oracle's come out of the table that the states hold."""
        masks = {
            control.name: self._mask(control, states)
            for control in self.controls
            if control.name not in (ORACLE, SOFT_ORACLE)
        }
        if states.oracle_mask is not None:
            masks[ORACLE] = states.oracle_mask
            masks[SOFT_ORACLE] = ascend(states.policy, states.observations, states.oracle_mask)
        return masks
