"""A unit of the work of scoring: one episode, explained by some explainers and measured beside the controls.

Matrix products round differently in batches of another size and in memory of another alignment, so an
episode is always one batch of its own, in tensors that torch allocates: what an explainer scores on it
depends on nothing but (policy, explainer, seed, episode, timesteps), and not on the other explainers.
"""

from __future__ import annotations

import copy
import time
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from xmarl_bench.entry.protocol import SANITY_TIMESTEPS
from xmarl_bench.errors import InputError
from xmarl_bench.explain.controls import CONTROLS, ORACLE, SOFT_ORACLE
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.explain.oracle import ascend
from xmarl_bench.explain.sanity import seed_stability, weight_randomisation
from xmarl_bench.policy import Policy
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.rollout.cell import spaced_timesteps
from xmarl_bench.rollout.episodes import Episode
from xmarl_bench.scoring.states import Budgets, States, Values, number


@dataclass(frozen=True)
class Explained:
    """What one explainer scored on one episode."""

    values: Values  # of `ExplanationRow`, and of the sanity checks where the unit asks for them
    budgets: Budgets  # of `EpisodeRow`
    inverted: Values  # of `ExplanationRow`, for 1 - mask
    seconds: float  # for the masks alone


@dataclass(frozen=True)
class Shared:
    """What an episode gives whoever explains it."""

    timesteps: int  # explained
    controls: dict[str, Values]  # of `ExplanationRow`, by control; no oracle where there is none
    policy: Values  # what is the policy's alone
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
    shared: bool = True  # measure the controls and the policy too

    def run(self) -> Measured:
        with one_thread():
            # A copy is laid out as torch lays it out, also where the policy came through a pickle.
            policy = copy.deepcopy(self.policy).eval()
            chosen = spaced_timesteps(len(self.episode.observations), self.timesteps)
            observations = torch.tensor(self.episode.observations[chosen])
            started = time.perf_counter()
            rng = np.random.default_rng(derived_seed("ties", self.seed, self.episode.seed))
            states = States.of(policy, observations, rng)
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
            sanity = self._sanity(explainer, states, mask) if self.sanity else {}
        except InputError as error:
            return error
        values, budgets, inverted = states.with_inverse(mask)
        return Explained({**values, **sanity}, budgets, inverted, seconds)

    def _mask(self, explainer: Explainer, states: States) -> Tensor:
        seed = derived_seed("explainer", self.seed, explainer.name, self.episode.seed)
        return run_explainer(explainer, states.policy, states.observations, seed)

    def _sanity(self, explainer: Explainer, states: States, mask: Tensor) -> Values:
        few = torch.from_numpy(spaced_timesteps(len(mask), SANITY_TIMESTEPS))
        observations, mask = states.observations[few], mask[few]
        seed = derived_seed("sanity", self.seed, explainer.name, self.episode.seed)
        values: Values = {
            "weight_randomisation": number(
                weight_randomisation(explainer, states.policy, observations, mask, seed)
            )
        }
        if explainer.stochastic:
            values["seed_stability"] = number(
                seed_stability(explainer, states.policy, observations, mask, seed)
            )
        return values

    def _control_masks(self, states: States) -> dict[str, Tensor]:
        """The masks of CONTROLS; the oracle's come out of the table that the states hold."""
        masks = {
            name: self._mask(control, states)
            for name, control in CONTROLS.items()
            if name not in (ORACLE, SOFT_ORACLE)
        }
        if states.oracle_mask is not None:
            masks[ORACLE] = states.oracle_mask
            masks[SOFT_ORACLE] = ascend(states.policy, states.observations, states.oracle_mask)
        return masks
