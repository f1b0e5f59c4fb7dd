"""What agents remember is carried from step to step, recorded, and forgotten between episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from xmarl_envs import VectorEnv, make_task

from tests.bench.policy.test_networks_refused import opened
from tests.helpers.recurrent_policies import (
    AttentionThenGru,
    LstmThenAttention,
    recurrent_policy,
    remembering,
)
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.policy import Policy, complete_graph
from xmarl_bench.render.recording import record
from xmarl_bench.reproducible import episode_seeds
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.rollout.reference_states import fit_states

TASK, D = "blind_navigation_v0", 6
POLICIES: dict[str, Policy] = {
    "gru, fast": recurrent_policy(remembering("gru", 1)),
    "lstm, fast": recurrent_policy(remembering("lstm", 0)),
    "code": opened(LstmThenAttention()),
}
every_policy = pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)


@pytest.mark.parametrize("network", [AttentionThenGru(), LstmThenAttention()], ids=["gru", "lstm"])
def test_an_episode_is_that_of_plain_torch(network: Any) -> None:
    """The same physics, stepped by a loop that knows the network alone."""
    (episode,) = roll_out(make_task(TASK, 3), opened(network), [5], max_cycles=20)
    env = VectorEnv(make_task(TASK, 3), 1, 20)
    x, state = env.reset([5])[0], network.initial_state(3)
    assert len(episode.observations) == 20
    for row in episode.observations:
        parts = state if isinstance(state, tuple) else (state,)
        np.testing.assert_allclose(row[:, :D], x, rtol=0, atol=1e-5)
        np.testing.assert_allclose(row[:, D:], torch.cat(parts, dim=-1).numpy(), rtol=0, atol=1e-5)
        with torch.no_grad():
            output, state = network.step(torch.from_numpy(x), complete_graph(3), state)
        x = env.step(torch.tanh(output[:, :2]).numpy()[None]).observation[0]
    assert np.abs(np.diff(episode.observations[..., D:], axis=0)).max() > 1e-3


@every_policy
def test_an_episode_depends_on_none_that_is_played_before_or_beside_it(policy: Policy) -> None:
    """One slot plays all of them, or each has its own."""
    played = [
        roll_out(make_task(TASK, 3), policy, [1, 2, 3], parallel_episodes=width, max_cycles=9)
        for width in (1, 2, 3)
    ]
    for episodes in zip(*played, strict=True):
        start = policy.initial_state(3).numpy()
        np.testing.assert_array_equal(episodes[0].observations[0, :, D:], start)
        for other in episodes[1:]:
            np.testing.assert_array_equal(episodes[0].observations, other.observations)


@every_policy
def test_a_recorded_state_answers_as_the_team_acted(policy: Policy) -> None:
    (episode,) = roll_out(make_task(TASK, 3), policy, [4], max_cycles=12)
    with torch.no_grad():
        memory = policy.step(torch.tensor(episode.observations))[1].numpy()
    np.testing.assert_allclose(memory[:-1], episode.observations[1:, :, D:], rtol=0, atol=1e-5)


def test_a_mask_acts_on_what_is_remembered() -> None:
    """Of a memory of what was heard; one of what an agent saw itself is the same at the next step."""
    eye, seeds = torch.eye(3), [4]
    for after in (0, 1):
        policy = recurrent_policy(remembering("gru", after))
        (full,), (mute,) = (
            roll_out(make_task(TASK, 3), policy, seeds, max_cycles=3, mask=mask) for mask in (None, eye)
        )
        first, second = (np.abs(full.observations[t] - mute.observations[t]) for t in (0, 1))
        assert first.max() == 0.0
        assert (second[:, D:].max() > 1e-3) == (after == 1)


@every_policy
def test_what_is_drawn_and_what_is_fitted_on_hold_memories_too(policy: Policy) -> None:
    task = make_task(TASK, 3)
    recording = record(task, "mine", policy, seed=7, episode=1, max_cycles=10)
    scored = roll_out(task, policy, episode_seeds(7, 2), max_cycles=10)[1]
    np.testing.assert_array_equal(recording.observations, scored.observations)

    def watch(policy: Policy, observations: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        np.testing.assert_array_equal(observations.numpy(), scored.observations[[3, 6]])
        return torch.ones(2, 3, 3)

    assert recording.explain(Explainer("watch", watch), [3, 6]).shape == (2, 3, 3)


@pytest.mark.slow
def test_states_to_be_fitted_on_hold_memories_too() -> None:
    policy = POLICIES["gru, fast"]
    states = fit_states(policy, Cell(TASK, 3))
    assert states.shape[1:] == (3, D + policy.memory_dim)
    assert states[..., D:].abs().max() > 0.1
