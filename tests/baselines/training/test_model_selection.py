"""The best policy of a run, by episodes that neither training nor scoring plays."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from xmarl_baselines.training import model_selection
from xmarl_baselines.training.model_selection import ModelSelection, plain_actor
from xmarl_baselines.training.trainer import VALIDATIONS, Run, build, train

from tests.baselines.training.small_runs import small
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.evaluation import evaluate

VALIDATED = model_selection.VALIDATION.seed


def test_validation_plays_no_episode_of_scoring() -> None:
    assert not set(Sampling(episodes=100, seed=VALIDATED).seeds) & set(Sampling(episodes=200).seeds)


def test_every_validation_is_kept(tmp_path: Path) -> None:
    model = build(Run(small()), seed=0)
    selection = ModelSelection(
        tmp_path,
        Cell("blind_navigation_v0", 3),
        every=160,
        after=320,
    )
    model.learn(640, callback=selection)
    selection.validate()
    curve = selection.curve()
    assert [row["frames"] for row in curve] == [160, 320, 480, 640]
    assert curve == json.loads((tmp_path / "curve.json").read_text())
    assert curve[0]["no_object_collision"] is None
    policy, record = selection.best()
    assert record["frames"] >= 320
    last = selection.policy_at(curve[-1]).state_dict()
    assert all(torch.equal(last[name], tensor) for name, tensor in plain_actor(model).state_dict().items())
    assert record == curve[-1] or any(not torch.equal(last[k], v) for k, v in policy.state_dict().items())


def test_a_run_validates_at_each_tenth_whether_resumed_or_not(tmp_path: Path) -> None:
    """ship.py needs this: a resumed run validates at the same frames as an uninterrupted one."""
    run, tenths = Run(small(frames=1600, batch_size=160, n_epochs=1)), [160 * k for k in range(1, 11)]
    assert VALIDATIONS == 10
    whole = train(run, tmp_path / "whole")
    assert [record["frames"] for record in whole.curve] == tenths

    def stop(frames: int, _: dict[str, float]) -> None:
        if frames >= 640:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(run, tmp_path / "resumed", checkpoint_every=1, report=stop)
    resumed = train(run, tmp_path / "resumed", resume=True)
    assert [record["frames"] for record in resumed.curve] == tenths


def test_a_run_resumed_between_two_tenths_validates_at_each_tenth(tmp_path: Path) -> None:
    """Iterations of 80 frames, tenths of 160: the run continues from frame 240."""
    run = Run(small(frames=1600, n_steps=10, batch_size=80, n_epochs=1))

    def stop(frames: int, _: dict[str, float]) -> None:
        if frames >= 320:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(run, tmp_path / "run", checkpoint_every=1, report=stop)
    assert json.loads((tmp_path / "run" / "progress.json").read_text())["frames"] == 240
    resumed = train(run, tmp_path / "run", resume=True)
    assert [record["frames"] for record in resumed.curve] == [160 * k for k in range(1, 11)]


def test_validation_equals_an_evaluation_of_the_same_episodes(tmp_path: Path) -> None:
    """Only rounding differs: validation plays all episodes in one batch."""
    trained = train(Run(small("blind_passage_v0")), tmp_path / "run")
    (measured,) = evaluate([(trained.policy, Cell("blind_passage_v0", 3))], model_selection.VALIDATION)
    for name in model_selection.MEASURES:
        assert trained.validation[name] == pytest.approx(measured.with_messages[name]), name
