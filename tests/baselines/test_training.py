"""MAPPO on SB3: the numbers of the update by hand, and that runs learn, repeat, resume and save."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.distributions import Normal, TransformedDistribution
from torch.distributions.transforms import TanhTransform
from xmarl_baselines.distance_attention import attend_by_distance
from xmarl_baselines.training.fast_layers import speed_up
from xmarl_baselines.training.mappo import MAPPO
from xmarl_baselines.training.model_selection import VALIDATION, ModelSelection, Record, plain_actor, worth
from xmarl_baselines.training.recipes import PAPER_NAVIGATION, RECIPES, Recipe, recipe_for
from xmarl_baselines.training.shaping import Shaping, distance_through_gap, training_reward
from xmarl_baselines.training.team_policy import log_prob
from xmarl_baselines.training.team_vec_env import TeamVecEnv
from xmarl_baselines.training.trainer import Run, build, train
from xmarl_envs import TASKS, BlindPassage, State, VectorEnv, make_task

from xmarl_bench.errors import InputError
from xmarl_bench.policy import ActionDistribution, Architecture, GraphPolicy
from xmarl_bench.rollout.cell import Cell, Sampling


@pytest.fixture(autouse=True)
def short_validation(monkeypatch: pytest.MonkeyPatch) -> None:
    short = Sampling(episodes=2, max_cycles=10, seed=VALIDATION.seed)
    monkeypatch.setattr("xmarl_baselines.training.model_selection.VALIDATION", short)


def small(task: str = "blind_navigation_v0", **changes: object) -> Recipe:
    """A recipe that runs in a second, without the warm start (see test_imitation)."""
    short = {"frames": 640, "n_envs": 8, "n_steps": 20, "batch_size": 80, "n_epochs": 2, "imitation": None}
    return recipe_for(task, **{**short, **changes})


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_a_recipe_that_trains(task: str, tmp_path: Path) -> None:
    trained = train(Run(small(task)), tmp_path / "run")
    assert trained.seconds > 0
    assert trained.validation["frames"] <= 640
    weights = trained.policy.state_dict()
    assert all(torch.isfinite(tensor).all() for tensor in weights.values())
    assert set(RECIPES) == set(TASKS)


def test_the_same_seed_trains_the_same_weights_and_another_does_not(tmp_path: Path) -> None:
    def weights(seed: int, folder: str) -> torch.Tensor:
        policy = train(Run(small(), seed=seed), tmp_path / folder).policy
        return torch.cat([tensor.flatten() for tensor in policy.state_dict().values()])

    first = weights(0, "a")
    assert torch.equal(first, weights(0, "b"))
    assert not torch.equal(first, weights(1, "c"))


def test_an_interrupted_run_goes_on_where_it_was(tmp_path: Path) -> None:
    run, folder = Run(small()), tmp_path / "run"

    def stop_half_way(frames: int, _: dict[str, float]) -> None:
        if frames >= 320:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(run, folder, checkpoint_every=1, report=stop_half_way)
    assert json.loads((folder / "progress.json").read_text())["frames"] == 160
    with pytest.raises(InputError, match="--resume"):
        train(run, folder)
    with pytest.raises(InputError, match="other settings"):
        train(replace(run, seed=1), folder, resume=True)
    seen: list[int] = []
    train(run, folder, resume=True, report=lambda frames, _: seen.append(frames))
    assert seen[0] == 160
    assert json.loads((folder / "progress.json").read_text())["frames"] == 640


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


def test_teams_report_the_reward_of_the_task_not_the_shaped_one() -> None:
    env = TeamVecEnv(make_task("blind_passage_v0"), 4, seed=0, max_cycles=5, shaping=Shaping(scale=0.0))
    env.reset()
    returns = []
    for _ in range(5):
        env.step_async(np.ones((4, 3, 2), np.float32))
        _, reward, _, infos = env.step_wait()
        assert (reward == 0).all()
        returns += [info["episode"]["r"] for info in infos if "episode" in info]
    assert len(returns) == 4
    assert all(value != 0 for value in returns)


def test_without_shaping_the_trainer_sees_the_reward_of_the_task() -> None:
    for name in TASKS:
        env = VectorEnv(make_task(name), 16)
        env.reset(range(16))
        rng = np.random.default_rng(0)
        for _ in range(40):
            before = env.world.position.copy()
            step = env.step(rng.uniform(-1, 1, (16, 3, 2)))
            shaped = training_reward(env.task, Shaping(), before, env.state, step)
            np.testing.assert_allclose(shaped, step.reward, atol=1e-12)


def test_proximity_is_one_at_contact_and_zero_out_of_range() -> None:
    task = make_task("blind_navigation_v0")
    env = VectorEnv(task, 1)
    env.reset([0])
    step = env.step(np.zeros((1, 3, 2)))
    shaping = Shaping(proximity_penalty=2.0, proximity_range=0.4)
    position = np.array([[[0.0, 0.0], [0.4, 0.0], [5.0, 0.0]]])  # surfaces 0.2 m apart: half way
    state = State(position, np.zeros_like(position), position.copy(), np.zeros((1, 0, 2)))
    near = training_reward(task, shaping, position, state, step)
    far = training_reward(task, Shaping(), position, state, step)
    np.testing.assert_allclose(near - far, [[-1.0, -1.0, 0.0]])


def test_the_way_through_the_gap() -> None:
    task = BlindPassage(n_agents=1)
    walls = np.array([[[-1.2515, 0.0], [1.2515, 0.0]]])  # the gap is at x = 0
    goal = np.array([[[0.0, 0.5]]])

    def way(x: float, y: float) -> float:
        position = np.array([[[x, y]]])
        state = State(position, np.zeros_like(position), goal, walls)
        return float(distance_through_gap(task, position, state)[0, 0])

    assert way(0.0, -0.5) == pytest.approx(1.0)  # straight below the gap it is the straight line
    assert way(0.0, 0.0) == pytest.approx(0.5)
    assert way(0.3, 0.5) == pytest.approx(0.3)
    assert way(0.5, -0.2) > way(0.2, -0.2) > way(0.0, -0.2)


def test_fast_layers_compute_the_same() -> None:
    torch.manual_seed(0)
    plain = GraphPolicy(Architecture.model_validate({**PAPER_NAVIGATION.architecture, "obs_dim": 6}))
    fast = GraphPolicy(plain.architecture)
    fast.load_state_dict(plain.state_dict())
    speed_up(fast)
    assert set(fast.state_dict()) == set(plain.state_dict())
    x = torch.randn(50, 3, 6)
    for policy in (plain, fast):
        policy.distribution(x).loc.square().mean().backward()
    torch.testing.assert_close(fast.distribution(x).loc, plain.distribution(x).loc, atol=1e-5, rtol=1e-5)
    for mine, theirs in zip(fast.parameters(), plain.parameters(), strict=True):
        if theirs.grad is not None and mine.grad is not None:
            assert (mine.grad - theirs.grad).norm() <= 0.02 * theirs.grad.norm() + 1e-7  # bfloat16 gradients


def test_attention_by_distance_prefers_self_then_the_nearest() -> None:
    torch.manual_seed(0)
    policy = GraphPolicy(Architecture.model_validate({**PAPER_NAVIGATION.architecture, "obs_dim": 6}))
    attend_by_distance(policy, 2.5)
    x = torch.zeros(1, 3, 6)
    x[0, 1, 0], x[0, 2, 0] = 0.3, 1.0
    row = policy.prepare(x).attention[0, 0].detach()
    assert row[0] > row[1] > row[2]
    assert float(row[1] / row[0]) == pytest.approx(np.exp(-2.5 * 0.8 * 0.3 * (1 + np.sqrt(2))), rel=0.3)


def test_model_selection_weighs_success_collisions_and_makespan() -> None:
    def record(success: float, agents: float, makespan: float = 50.0) -> Record:
        return {"success_rate": success, "no_agent_collision": agents, "makespan": makespan}

    def best(*records: Record, enough: float = 0.9, care: float = 0.5) -> Record:
        return max(records, key=lambda row: worth(row, enough, care))

    assert best(record(0.95, 0.2), record(0.91, 0.6)) == record(0.91, 0.6)
    assert best(record(0.8, 0.3), record(0.7, 0.4)) == record(0.8, 0.3)
    assert best(record(0.95, 0.2, makespan=40.0), record(0.99, 0.2)) == record(0.95, 0.2, makespan=40.0)
    assert best(record(0.8, 0.9), record(0.81, 0.0), care=0.0) == record(0.81, 0.0)


def test_model_selection_keeps_every_look_and_plays_no_episode_of_scoring(tmp_path: Path) -> None:
    assert not set(VALIDATION.seeds) & set(Sampling(episodes=50).seeds)
    model = build(Run(small()), seed=0)
    selection = ModelSelection(
        tmp_path,
        Cell("blind_navigation_v0", 3),
        every=160,
        after=320,
        enough_success=1.0,
        care=0.0,
        warm_start=True,
    )
    model.learn(640, callback=selection)
    selection.validate()
    curve = selection.curve()
    assert [row["frames"] for row in curve] == [0, 160, 320, 480, 640]
    assert curve == json.loads((tmp_path / "curve.json").read_text())
    assert curve[0]["no_object_collision"] is None
    policy, record = selection.best()
    assert record["frames"] >= 320
    last = selection.policy_at(curve[-1]).state_dict()
    assert all(torch.equal(last[name], tensor) for name, tensor in plain_actor(model).state_dict().items())
    assert record == curve[-1] or any(not torch.equal(last[k], v) for k, v in policy.state_dict().items())


def test_caution_grows_over_the_run(tmp_path: Path) -> None:
    shaping = Shaping(agent_penalty=0.2, proximity_penalty=0.1).with_caution(3.0)
    assert (shaping.agent_penalty, shaping.proximity_penalty) == pytest.approx((0.6, 0.3))
    assert Shaping().with_caution(3.0) == Shaping()
    seen: list[float] = []

    class Watch(TeamVecEnv):
        def __setattr__(self, name: str, value: object) -> None:
            if name == "caution":
                seen.append(float(value))  # type: ignore[arg-type]
            super().__setattr__(name, value)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xmarl_baselines.training.trainer.TeamVecEnv", Watch)
        train(Run(small(caution_growth=3.0)), tmp_path / "run")
    assert seen == pytest.approx([1.0, 1.0, 1.5, 2.0, 2.5])


def test_a_run_can_start_from_a_finished_one(tmp_path: Path) -> None:
    first = Run(small(caution_growth=0.5, shaping=Shaping(agent_penalty=0.4)))
    train(first, tmp_path / "first")
    tuned = first.recipe.fine_tuning()
    assert (tuned.frames, tuned.caution_growth, tuned.shaping.agent_penalty) == (160, 1.0, 0.2)
    second = Run(replace(tuned, learning_rate=0.0), attention_entropy=0.1, start_from="first")
    trained = train(second, tmp_path / "second", start_from=tmp_path / "first")
    assert second.settings()["start_from"] == "first"
    finished = MAPPO.load(tmp_path / "first" / "checkpoint.zip").policy.actor.state_dict()
    for name, tensor in trained.policy.state_dict().items():  # nothing was learned at a rate of 0
        assert torch.equal(tensor, finished[name]), name


def test_bad_recipes_and_tasks_are_refused() -> None:
    with pytest.raises(InputError, match=r"unknown|no training recipe"):
        recipe_for("blind_chess_v0")
    with pytest.raises(InputError, match="batch_size must be from 1 to"):
        small(batch_size=10_000)
