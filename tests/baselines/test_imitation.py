"""Imitation of the heuristics: it learns, repeats, and the actor afterwards explores as told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from xmarl_baselines.imitation import Imitation, imitate
from xmarl_baselines.recipes import RECIPES
from xmarl_baselines.team_policy import mean_attention_entropy
from xmarl_baselines.trainer import Run, build, train
from xmarl_envs import TASKS, BlindPassage, VectorEnv, make_task
from xmarl_envs.heuristics import heuristic
from xmarl_envs.heuristics.ladder import ladder
from xmarl_envs.heuristics.wide_berth import wide_berth

from tests.baselines.test_training import short_validation, small
from xmarl_bench.errors import InputError
from xmarl_bench.policy import Architecture, GraphPolicy

__all__ = ["short_validation"]  # a fixture, for every test here
TINY = Imitation(rounds=6, n_envs=20, updates=10, batch_size=100)


def actor_of(task: str, seed: int = 0) -> GraphPolicy:
    torch.manual_seed(seed)
    record = {**RECIPES[task].architecture, "obs_dim": make_task(task).obs_dim}
    return GraphPolicy(Architecture.model_validate(record))


@pytest.mark.parametrize("task", TASKS)
def test_the_error_falls_and_the_scale_is_reached(task: str) -> None:
    errors: list[float] = []
    actor = actor_of(task)
    shown_all_along = 1e9  # the heuristic never hands over, so that all rounds see states of one kind
    how = Imitation(rounds=12, n_envs=20, updates=20, batch_size=100, guided=shown_all_along)
    imitate(actor, make_task(task), how, seed=0, report=lambda _, log: errors.append(log["imitation_error"]))
    assert len(errors) == 12
    assert errors[-1] < 0.8 * errors[0]
    with torch.no_grad():
        scale = actor.distribution(0.5 * torch.randn(50, 3, make_task(task).obs_dim)).scale
    assert 0.1 < float(scale.median()) < 0.7  # 1.0 before


def test_the_same_seed_teaches_the_same_and_another_does_not() -> None:
    def weights(seed: int) -> torch.Tensor:
        actor = actor_of("blind_discovery_v0")
        imitate(actor, make_task("blind_discovery_v0"), TINY, seed=seed)
        return torch.cat([parameter.detach().flatten() for parameter in actor.parameters()])

    before = torch.get_rng_state()
    first = weights(0)
    torch.manual_seed(99)
    assert torch.equal(first, weights(0))
    assert not torch.equal(first, weights(1))
    torch.set_rng_state(before)


def test_attention_entropy_is_part_of_the_loss() -> None:
    def entropy(lam: float) -> float:
        seen: list[float] = []
        actor = actor_of("blind_discovery_v0")
        imitate(
            actor,
            make_task("blind_discovery_v0"),
            replace(TINY, attention_start=0.0, attention_ramp=0.1),
            seed=0,
            attention_entropy=lam,
            report=lambda _, log: seen.append(log["attention_entropy"]),
        )
        return seen[-1]

    assert entropy(0.5) < 0.85 * entropy(0.0)


def test_attention_that_vanishes_has_a_finite_gradient() -> None:
    score = torch.tensor([[0.0, -200.0]], requires_grad=True)
    mean_attention_entropy(torch.softmax(score, dim=-1)).backward()
    assert score.grad is not None and torch.isfinite(score.grad).all()
    even = mean_attention_entropy(torch.full((2, 3, 3), 1 / 3))
    torch.testing.assert_close(even, torch.tensor(3.0).log())


def test_a_run_imitates_first_and_is_not_taught_twice(tmp_path: Path) -> None:
    run = Run(small(imitation=TINY, learning_rate=0.0))
    reports: list[int] = []

    def stop(frames: int, _: dict[str, float]) -> None:
        reports.append(frames)
        if frames:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(run, tmp_path / "run", report=stop)
    assert reports[:6] == [0] * 6
    reports.clear()
    resumed = train(run, tmp_path / "run", resume=True, report=lambda frames, _: reports.append(frames))
    assert reports.count(0) == 1  # where MAPPO begins
    taught = build(run, seed=run.seed).policy.actor
    imitate(taught, make_task(run.recipe.task, 3), TINY, seed=run.seed)
    for name, tensor in resumed.policy.state_dict().items():  # MAPPO learned nothing at a rate of 0
        assert torch.equal(tensor, taught.state_dict()[name]), name


def test_only_the_critic_learns_at_first() -> None:
    model = build(Run(small(critic_first=0.5)), seed=0)
    actor = {name: tensor.clone() for name, tensor in model.policy.actor.state_dict().items()}
    critic = {name: tensor.clone() for name, tensor in model.policy.critic.state_dict().items()}

    def changed(before: dict[str, torch.Tensor], module: torch.nn.Module) -> bool:
        return any(not torch.equal(before[name], tensor) for name, tensor in module.state_dict().items())

    class StopError(Exception):
        pass

    def at(frames: int) -> None:
        def callback(*_: object) -> bool:
            if model.num_timesteps >= frames:
                raise StopError
            return True

        with pytest.raises(StopError):
            model.learn(640, callback=callback)

    at(320)
    assert changed(critic, model.policy.critic) and not changed(actor, model.policy.actor)
    model.learn(640)
    assert changed(actor, model.policy.actor)


def alone(rounds: int = 20) -> Run:
    """Imitation as the whole of training, in a second."""
    recipe = RECIPES["blind_navigation_v0"]
    assert recipe.frames == 0 and recipe.imitation is not None
    how = replace(recipe.imitation, rounds=rounds, n_envs=10, updates=2, batch_size=50)
    return Run(replace(recipe, imitation=how, n_envs=2, n_steps=20, batch_size=40))


def test_a_run_of_imitation_alone_is_looked_at_along_training(tmp_path: Path) -> None:
    run = alone()
    trained = train(run, tmp_path / "run")
    assert run.recipe.played == 20 * 25 * 10
    assert [record["frames"] for record in trained.curve] == list(range(500, 5001, 500))
    assert len(list((tmp_path / "run" / "validated").iterdir())) == 10
    again = train(run, tmp_path / "run", resume=True)  # finished: nothing is trained, the same is chosen
    assert again.validation == trained.validation and again.curve == trained.curve
    assert again.seconds == pytest.approx(trained.seconds, abs=1.0)
    once_more = train(run, tmp_path / "other")
    for name, tensor in trained.policy.state_dict().items():
        assert torch.equal(tensor, once_more.policy.state_dict()[name]), name


def test_looks_before_lambda_is_whole_are_not_chosen(tmp_path: Path) -> None:
    run = replace(alone(), attention_entropy=0.1)
    assert run.regularised_from == pytest.approx(0.7 * 5000)
    assert train(run, tmp_path / "run").validation["frames"] >= 3500
    assert alone().regularised_from == 0.0


def test_imitation_alone_is_shortened_and_not_fine_tuned() -> None:
    recipe = alone().recipe.shortened(2500)
    assert recipe.imitation is not None and (recipe.frames, recipe.imitation.rounds) == (0, 10)
    with pytest.raises(InputError, match="imitation alone"):
        recipe.fine_tuning()
    with pytest.raises(InputError, match="needs frames"):
        replace(recipe, imitation=None)


def test_whom_an_agent_attends_to_may_stay_as_it_is() -> None:
    actor = actor_of("blind_navigation_v0")
    before = {name: tensor.clone() for name, tensor in actor.state_dict().items()}
    imitate(actor, make_task("blind_navigation_v0"), replace(TINY, attention_rate=0.0), seed=0)
    same = {name for name, tensor in actor.state_dict().items() if torch.equal(before[name], tensor)}
    assert same == {"gat.att", "gat.lin_r.weight", "gat.lin_r.bias"}


def test_the_teacher_is_chosen() -> None:
    task = make_task("blind_navigation_v0")
    env = VectorEnv(task, 4)
    env.reset(range(4))
    smooth, own = replace(TINY, teacher="wide_berth"), TINY
    assert np.array_equal(smooth.shows(task, env.state), wide_berth(task, env.state))  # type: ignore[arg-type]
    assert np.array_equal(own.shows(task, env.state), heuristic(task, env.state))
    with pytest.raises(InputError, match="teacher must be"):
        replace(TINY, teacher="nobody")


def test_the_ladder_teaches_passage() -> None:
    task = BlindPassage(3)
    env = VectorEnv(task, 4)
    env.reset(range(4))
    how = replace(TINY, teacher="ladder")
    np.testing.assert_array_equal(how.shows(task, env.state), ladder(task, env.state))
    assert RECIPES["blind_passage_v0"].imitation is not None
    assert RECIPES["blind_passage_v0"].imitation.teacher == "ladder"
