"""Scores of explainers on planted truth."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from tests.conftest import RunCli
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.meta.planted_suite import PlantedScore, agreement, means_of, score_planted
from xmarl_bench.planted.families import FAMILIES
from xmarl_bench.plugins.registry import find_explainer


@pytest.mark.slow
def test_explainers_have_their_known_strengths_and_weaknesses() -> None:
    """Occlusion cannot see a redundant pair; attention fails only on the decoy."""
    names = ("attention", "occlusion", "shapley")
    found = score_planted([find_explainer(name) for name in names], sizes=[5], n_steps=30)

    def of(family: str, explainer: str) -> PlantedScore:
        return next(each for each in found if (each.family, each.explainer) == (family, explainer))

    assert of("redundant-pair", "occlusion").auroc == pytest.approx(0.5, abs=0.02)
    assert (of("redundant-pair", "shapley").auroc or 0.0) > 0.99
    assert (of("decoy", "attention").auroc or 1.0) < 0.8
    assert (of("decoy", "occlusion").auroc or 0.0) > 0.99
    for family in set(FAMILIES) - {"decoy"}:
        assert (of(family, "attention").auroc or 0.0) > 0.99, family
    for family in FAMILIES:
        ones = of(family, "all-ones")
        assert (ones.auroc, ones.fidelity) == (0.5, 0.0)
        assert abs((of(family, "random").auroc or 0.0) - 0.5) < 0.1
    tau = agreement(found)
    assert tau is not None
    assert tau > 0.5


def test_a_failing_explainer_is_reported_and_does_not_stop_the_others() -> None:
    def broken(policy: object, observations: torch.Tensor, generator: object) -> torch.Tensor:
        raise ValueError("not today")

    found = score_planted([Explainer("broken", broken)], sizes=[4], n_steps=3)
    errors = [each.error for each in found if each.explainer == "broken"]
    assert len(errors) == len(FAMILIES)
    assert all(error is not None and "not today" in error for error in errors)
    assert set(means_of(found)) == {"random", "all-ones"}
    assert agreement(found) is None
    with pytest.raises(InputError, match="3 to 10 agents"):
        score_planted([], sizes=[11])


@pytest.mark.slow
def test_the_command_writes_the_same_bytes_again(run_cli: RunCli, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = run_cli("score", "--suite", "planted", "--explainer", "attention", "--out", str(out))
    assert first.code == 0, first.err
    assert "Kendall's tau" in first.out
    written = (out / "planted.json").read_bytes()
    assert {each["family"] for each in json.loads(written)["found"]} == set(FAMILIES)
    assert run_cli("score", "--suite", "planted", "--explainer", "attention", "--out", str(out)).code == 0
    assert (out / "planted.json").read_bytes() == written


@pytest.mark.slow
def test_one_that_needs_a_world_is_left_out_in_one_sentence(run_cli: RunCli, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "def imagined(observations, simulator):\n    raise AssertionError('there is no world')\n"
    )
    own = f"{tmp_path / 'own.py'}:imagined"
    ran = run_cli("score", "--suite", "planted", "--explainer", own, "--out", tmp_path / "out")
    assert ran.code == 2  # there is no other
    assert ran.err.count("explainer 'imagined' plays on in the world of an episode") == 1
    assert "one-sender of 4 and 17 more: explainer 'imagined'" in ran.err
