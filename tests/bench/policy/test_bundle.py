"""Policies are saved and loaded without changes. Damaged bundles are in test_cli."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.conftest import MakeBundle
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.policy import load_policy, save_policy
from xmarl_bench.policy.untrusted import CARD


def test_saving_and_loading_keeps_every_bit(tmp_path: Path) -> None:
    policy = small_policy(6, 3)
    saved = save_policy(
        tmp_path / "x", policy, name="x", task="blind_navigation_v0", n_agents=3, attention_entropy=0.1
    )
    loaded, card = load_policy(tmp_path / "x")
    assert card == saved
    assert not loaded.training
    observations = random_observations(4, 3, 6)
    with torch.no_grad():
        assert torch.equal(loaded.distribution(observations).loc, policy.distribution(observations).loc)
    again = save_policy(tmp_path / "y", loaded, **card.model_dump(exclude={"architecture", "weights_sha256"}))
    assert again.weights_sha256 == card.weights_sha256


def test_a_card_that_is_no_json_leaves_the_bundle_that_is_there(make_bundle: MakeBundle) -> None:
    bundle = make_bundle()
    _, card = load_policy(bundle)
    fields = card.model_dump(exclude={"architecture", "weights_sha256", "training"})
    with pytest.raises(InputError, match=r"cannot be written as JSON .*: give it plain numbers"):
        save_policy(bundle, small_policy(6, 4), **fields, training={"lr": np.float32(3e-4)})
    assert load_policy(bundle)[1] == card


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("surprise", 1, "surprise"),
        ("name", "../escape", "name"),
        ("weights_sha256", "abc", "weights_sha256"),
        ("architecture", {"kind": "pickle"}, "architecture"),
        ("n_agents", 0, "n_agents"),
    ],
)
def test_an_invalid_card_is_refused(make_bundle: MakeBundle, key: str, value: object, said: str) -> None:
    folder = make_bundle()
    card = json.loads((folder / CARD).read_text())
    (folder / CARD).write_text(json.dumps(card | {key: value}))
    with pytest.raises(InputError, match=said):
        load_policy(folder)
