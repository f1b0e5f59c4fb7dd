"""A unit of scoring work: one episode, explained by some explainers and measured together with the controls.

Rounding of matrix products depends on the size of a batch and on the alignment of its memory. So an episode
is always one batch, in tensors that torch allocates: an explainer's score on it depends on (policy,
explainer, seed, episode, timesteps) only, and not on the other explainers.
"""

from __future__ import annotations

import copy
import math
import time
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from xmarl_bench.entry.metric_records import BudgetRow, ExplanationRow, PolicyRow, SanityRow
from xmarl_bench.entry.protocol import SANITY_TIMESTEPS
from xmarl_bench.errors import InputError
from xmarl_bench.explain.control_names import ORACLE, SOFT_ORACLE
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.explain.oracle import ascend
from xmarl_bench.explain.sanity import seed_stability, weight_randomisation
from xmarl_bench.policy import Policy
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.rollout.cell import spaced_timesteps
from xmarl_bench.rollout.episodes import Episode
from xmarl_bench.scoring.rankings import number
from xmarl_bench.scoring.states import States


@dataclass(frozen=True)
class Explained:
    """Scores of one explainer on one episode."""

    row: ExplanationRow
    budgets: dict[str, BudgetRow]  # by their names in the row
    inverted: ExplanationRow  # of 1 - mask
    sanity: SanityRow | None  # None if the unit does not check it
    seconds: float  # for the masks only


@dataclass(frozen=True)
class Shared:
    """Measurements of one episode that all explainers share."""

    timesteps: int  # explained
    controls: dict[str, ExplanationRow]  # without the oracle if there is none
    policy: PolicyRow
    seconds: float  # without the explainers' masks and metrics


@dataclass(frozen=True)
class Measured:
    explained: dict[str, Explained | InputError]  # by explainer; the error of one does not stop the others
    shared: Shared | None  # None if the unit does not measure it


@dataclass(frozen=True)
class Unit:
    """One episode to explain and measure: a unit of work for a worker."""

    policy: Policy
    explainers: tuple[Explainer, ...]
    episode: Episode
    seed: int  # of the run
    timesteps: int | None  # at most so many; None: all
    sanity: bool  # also check stability between seeds and shuffled weights
    reference: Tensor | None = None  # (Q, N, D): see xmarl_bench.explain.absence
    controls: tuple[Explainer, ...] = tuple(CONTROLS.values())
    shared: bool = True  # also measure the controls and the policy

    def run(self) -> Measured:
        with one_thread():
            # torch aligns the copy's memory; pickle does not.
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
        """The masks of the controls; the oracle's come from the table of the states."""
        masks = {
            control.name: self._mask(control, states)
            for control in self.controls
            if control.name not in (ORACLE, SOFT_ORACLE)
        }
        if states.oracle_mask is not None:
            masks[ORACLE] = states.oracle_mask
            masks[SOFT_ORACLE] = ascend(states.policy, states.observations, states.oracle_mask)
        return masks
