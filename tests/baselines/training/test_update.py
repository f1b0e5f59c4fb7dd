"""MAPPO on SB3: the values of an update, computed by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.distributions import Normal, TransformedDistribution
from torch.distributions.transforms import TanhTransform
from xmarl_baselines.training.mappo import MAPPO
from xmarl_baselines.training.model_selection import plain_actor
from xmarl_baselines.training.team_policy import log_prob
from xmarl_baselines.training.team_vec_env import TeamVecEnv
from xmarl_baselines.training.trainer import Run, build
from xmarl_envs import make_task

from tests.baselines.training.small_runs import small
from xmarl_bench.policy import ActionDistribution


def test_sb3_saves_and_loads_the_learner(tmp_path: Path) -> None:
    model = build(Run(small()), seed=0)
    model.learn(320)
    model.save(tmp_path / "model")
    loaded = MAPPO.load(tmp_path / "model", env=model.get_env())
    observation = np.random.default_rng(0).normal(size=(5, 3, 6)).astype(np.float32)
    before, _ = model.predict(observation, deterministic=True)
    after, _ = loaded.predict(observation, deterministic=True)
    assert np.array_equal(before, after)
    loaded.learn(160)


def test_the_plain_actor_is_the_trained_one() -> None:
    model = build(Run(small()), seed=0)
    model.learn(160)
    x = torch.randn(7, 3, 6)
    trained, plain = model.policy.actor.distribution(x), plain_actor(model).distribution(x)
    torch.testing.assert_close(trained.loc, plain.loc, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(trained.scale, plain.scale, atol=1e-5, rtol=1e-5)


def test_log_probability_is_that_of_a_tanh_normal() -> None:
    torch.manual_seed(0)
    loc, scale = torch.randn(4, 3, 2, dtype=torch.double), torch.rand(4, 3, 2, dtype=torch.double) + 0.1
    expected = TransformedDistribution(Normal(loc, scale), [TanhTransform()])
    action = expected.sample()
    received = log_prob(ActionDistribution(loc, scale), action)
    torch.testing.assert_close(received, expected.log_prob(action).sum(-1))


def test_advantages_are_gae_for_each_agent() -> None:
    buffer = build(Run(small(gamma=0.9, gae_lambda=0.8)), seed=0).rollout_buffer
    rng = np.random.default_rng(0)
    for name in ("rewards", "values"):
        getattr(buffer, name)[:] = rng.normal(size=buffer.rewards.shape)
    buffer.episode_starts[:] = rng.random(buffer.episode_starts.shape) < 0.2
    last, dones = rng.normal(size=(8, 3)).astype(np.float32), rng.random(8) < 0.5
    buffer.compute_returns_and_advantage(torch.from_numpy(last), dones)
    team, agent = 5, 2  # the recursion of Schulman et al. 2016, written out for one agent of one team
    expected, following, value = 0.0, 1.0 - dones[team], last[team, agent]
    for t in reversed(range(20)):
        delta = buffer.rewards[t, team, agent] + 0.9 * value * following - buffer.values[t, team, agent]
        expected = delta + 0.9 * 0.8 * following * expected
        assert buffer.advantages[t, team, agent] == pytest.approx(expected, abs=1e-5)
        following, value = 1.0 - buffer.episode_starts[t, team], buffer.values[t, team, agent]


def test_minibatches_are_on_the_device_of_the_policy() -> None:
    buffer = build(Run(small()), seed=0).rollout_buffer
    buffer.device = torch.device("meta")  # as any that is not the CPU
    assert {each.device.type for each in next(buffer.minibatches(4, normalize_advantage=True))} == {"meta"}


def test_an_action_that_became_far_likelier_leaves_weights_finite() -> None:
    """Its ratio would be infinite, which a negative advantage does not clip."""
    model = build(Run(small()), seed=0)
    model.learn(160)
    samples = next(iter(model.rollout_buffer.minibatches(40, True)))
    samples.log_probs[0] -= 1e4
    samples.advantages[0] = -1.0
    measured = model._update(samples)
    assert np.isfinite(list(measured.values())).all()
    assert all(bool(torch.isfinite(weights).all()) for weights in model.policy.parameters())


@pytest.mark.parametrize(
    ("deviations", "excess"),
    [(0.0, (2.0, 0.5)), (1.5, (3.5, 5.0))],  # means 5 and -3.5, standard deviations 1 and 3
)
def test_raw_actions_beyond_3_cost_the_square_of_the_excess(
    deviations: float, excess: tuple[float, float]
) -> None:
    recipe = small(saturation_penalty=0.1, saturation_deviations=deviations)
    model = build(Run(recipe), seed=0)
    model.learn(160)
    last = model.policy.actor.decoder[-1]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.tensor([5.0, -3.5, 0.0, math.log((math.e**3 - 1) / (math.e - 1))]))
    samples = next(iter(model.rollout_buffer.minibatches(40, True)))
    torch.manual_seed(0)
    loss, measures = model._loss(samples)
    assert measures["saturation"] == pytest.approx(sum(each**2 for each in excess) / 2)
    model.saturation_penalty = 0.0
    torch.manual_seed(0)
    without, _ = model._loss(samples)
    assert (loss - without).item() == pytest.approx(0.1 * measures["saturation"], rel=1e-3)


def test_attention_entropy_falls_under_a_large_lambda() -> None:
    def entropy(weight: float) -> float:
        recipe = small(frames=4800, n_epochs=4, attention_start=0.0, attention_ramp=0.0, learning_rate=3e-3)
        model = build(Run(recipe, attention_entropy=weight), seed=0)
        model.learn(recipe.frames)
        policy = plain_actor(model)
        attention = policy.prepare(torch.randn(64, 3, 6)).attention
        return float(torch.special.entr(attention).sum(-1).mean().detach())

    assert entropy(10.0) < entropy(0.0) - 0.1


def test_lambda_starts_late_and_ramps() -> None:
    model = build(Run(small(attention_start=0.5, attention_ramp=0.2), attention_entropy=2.0), seed=0)
    for remaining, expected in ((1.0, 0.0), (0.5, 0.0), (0.4, 1.0), (0.3, 2.0), (0.0, 2.0)):
        model._current_progress_remaining = remaining
        assert model.attention_weight() == pytest.approx(expected)


def test_truncated_teams_are_bootstrapped_and_ended_ones_are_not() -> None:
    task = make_task("blind_navigation_v0")
    env = TeamVecEnv(task, 2, seed=0, max_cycles=3, copies_per_space=1)
    recipe = small(n_envs=2, n_steps=3, batch_size=6, gamma=0.5)
    model = MAPPO(
        "TeamPolicy", env, n_steps=3, batch_size=6, gamma=0.5, seed=0, device="cpu",
        policy_kwargs={"architecture": recipe.architecture, "critic": (8,)},
    )  # fmt: skip
    with torch.no_grad():
        for parameter in model.policy.critic.parameters():
            parameter.zero_()
        last = model.policy.critic[-1]
        assert isinstance(last, torch.nn.Linear)
        last.bias.add_(100.0)
    model.learn(6)
    rewards = model.rollout_buffer.rewards
    assert (np.abs(rewards) > 40).all(axis=-1).sum() == 2  # each team was truncated once, worth 0.5 * 100
    assert (np.abs(rewards) < 10).all(axis=-1).sum() == 4
