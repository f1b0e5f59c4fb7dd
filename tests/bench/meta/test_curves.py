"""Metrics along degraded rankings: what follows the steps by definition, what does not, what is left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import save_bundle
from xmarl_bench.meta.curves import METRICS, Curve, followed, planted_curves, trained_curves
from xmarl_bench.meta.degradation import NOISE, Form
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import load_policy


@pytest.fixture(scope="module")
def planted() -> list[Curve]:
    return list(planted_curves(sizes=[5], n_steps=60))


def one(curves: list[Curve], metric: str, policy: str, form: Form = Form.SAME_VALUES) -> Curve:
    (found,) = (each for each in curves if (each.metric, each.policy, each.form) == (metric, policy, form))
    return found


@pytest.mark.slow
def test_the_truth_is_best_and_noise_leads_to_chance(planted: list[Curve]) -> None:
    """A receiver that reads one sender: the truth nests, so it is the upper bound; all noise is 0."""
    curve = one(planted, "comm_budgeted_fidelity", "one-sender, 5")
    assert curve.values[0] == pytest.approx(1.0, abs=1e-3)
    assert list(curve.values) == sorted(curve.values, reverse=True)
    assert abs(curve.values[-1]) < 0.25
    assert curve.follows == pytest.approx(1.0)


@pytest.mark.slow
def test_a_form_moves_fid_delta_and_not_the_ranking(planted: list[Curve]) -> None:
    rank, soft = ("message_fidelity", "fid_delta")
    for metric, least, most in ((rank, 0.9, 1.0), (soft, -1.0, 0.6)):
        more = followed(planted, metric, Form.KEEPS_MORE)
        assert least <= more.within <= most, metric
        assert followed(planted, metric, Form.SAME_VALUES).within > 0.9, metric
    ends = [one(planted, soft, "one-sender, 5", form).values for form in Form]
    assert ends[0][0] == ends[1][0]  # the right one is the same in both
    assert ends[1][-1] > ends[1][3] > ends[0][-1]


@pytest.mark.slow
def test_what_keeps_the_action_does_not_see_redundancy() -> None:
    """Masks keep two of three messages, so always one of the pair: nothing but rounding changes."""
    curves = list(planted_curves(sizes=[4], n_steps=20))
    for metric in ("fid_minus", "gef", "median_kl"):
        assert one(curves, metric, "redundant-pair, 4").follows == 0.0, metric


def test_what_follows_within_and_over_policies() -> None:
    """Each falls at every step, at its own level: within they are perfect, together they are not."""
    steps = np.arange(len(NOISE))
    curves = [
        Curve(name, Form.SAME_VALUES, None, "fid_delta", tuple(level - steps))
        for name, level in (("low", 0.0), ("high", 100.0))
    ]
    found = followed(curves, "fid_delta", Form.SAME_VALUES)
    assert (found.within, found.smallest) == pytest.approx((1.0, 1.0))
    assert 0.4 < found.over < 0.6
    reversed_ = [Curve(each.policy, each.form, None, "gef", each.values) for each in curves]
    other = followed(reversed_, "gef", Form.SAME_VALUES)
    assert (other.within, other.smallest, other.over) == pytest.approx((-1.0, -1.0, -found.over))
    nothing = followed([], "fid_delta", Form.SAME_VALUES)
    assert np.isnan([nothing.within, nothing.smallest, nothing.over]).all()


@pytest.mark.slow
def test_no_metric_is_tested_on_the_absence_model_it_is_under(tmp_path: Path) -> None:
    policy, card = load_policy(save_bundle(tmp_path))
    curves = list(trained_curves(policy, card, episodes=1, timesteps=2))
    asked = {metric: {each.right for each in curves if each.metric == metric} for metric in METRICS}
    everything = set(Absence)
    for metric, model in (
        ("fid_delta", Absence.ZERO), ("comm_budgeted_fidelity", Absence.ZERO),
        ("mean_budgeted_fidelity", Absence.MEAN), ("resample_budgeted_fidelity", Absence.RESAMPLE),
        ("renormalised_budgeted_fidelity", Absence.RENORMALISED),
    ):  # fmt: skip
        assert asked[metric] == everything - {model}
    assert asked["message_fidelity"] == asked["smallest_message_fidelity"] == everything

    def right(metric: str) -> float:
        (found,) = (
            each for each in curves
            if (each.metric, each.right, each.form) == (metric, Absence.ZERO, Form.SAME_VALUES)
        )  # fmt: skip
        return found.values[0]

    others = [right(f"{model.prefix}_budgeted_fidelity") for model in everything - {Absence.ZERO}]
    assert right("message_fidelity") == pytest.approx(np.mean(others))
    assert right("smallest_message_fidelity") == pytest.approx(min(others))
