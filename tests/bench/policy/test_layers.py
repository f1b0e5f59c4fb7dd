"""Layered architectures: the networks they build, which of them take the fast path, their scores."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from tests.helpers.policies import random_masks, random_observations, small_policy
from xmarl_bench import score
from xmarl_bench.errors import InputError
from xmarl_bench.policy import (
    GraphPolicy,
    LayeredArchitecture,
    ModulePolicy,
    build_policy,
    load_policy,
    save_policy,
)
from xmarl_bench.policy.build import LayeredPolicy, weights_of
from xmarl_bench.policy.layers import LayeredNetwork
from xmarl_bench.policy.shapes import weight_shapes

GAT2 = [{"conv": "GATConv", "width": 4, "heads": 2, "activation": "elu"}] * 2
TRANSFORMER = [{"conv": "TransformerConv", "width": 6, "heads": 3, "concat": False, "activation": "tanh"}]
CARD: dict[str, Any] = {"task": "blind_navigation_v0", "n_agents": 3, "attention_entropy": 0.0}


def record(layers: list[dict[str, Any]], /, **changes: Any) -> LayeredArchitecture:
    given: dict[str, Any] = {
        "obs_dim": 6,
        "encoder": (7,),
        "encoder_activation": "relu",
        "layers": tuple(layers),
        "decoder": (9,),
        "decoder_activation": "tanh",
    }
    return LayeredArchitecture.model_validate({**given, **changes})


def random_policy(architecture: LayeredArchitecture, seed: int = 0) -> Any:
    generator = torch.Generator().manual_seed(seed)
    weights = {
        name: torch.randn(shape, generator=generator) * 0.5
        for name, shape in weight_shapes(architecture).items()
    }
    return build_policy(architecture, weights)


@pytest.mark.slow
@pytest.mark.parametrize("layers", [GAT2, TRANSFORMER], ids=["two layers of two heads", "transformer"])
def test_deep_policies_are_scored_on_the_generic_path(layers: list[dict[str, Any]], tmp_path: Path) -> None:
    saved = save_policy(tmp_path / "deep", random_policy(record(layers)), name="deep", **CARD)
    policy, card = load_policy(tmp_path / "deep")
    assert isinstance(policy, ModulePolicy)
    assert card == saved
    entry = score(tmp_path / "deep", "attention", episodes=2, timesteps=4, max_cycles=8, behaviour_episodes=1)
    cell = entry.results[0]
    assert entry.policy.architecture == record(layers)
    assert not entry.policy.trusted_code
    assert cell.metrics.fid_plus.value is not None
    assert cell.metrics.fid_plus.value > 1e-3
    assert cell.controls["all-ones"].fid_minus.value == 0.0
    assert cell.oracle_kind == ("enumerated" if len(layers) == 1 else "sampled")
    assert "comm_budgeted_fidelity" not in cell.not_measured
    assert "renormalised_budgeted_fidelity" in cell.not_measured


@pytest.mark.slow
@settings(max_examples=15)
@given(
    conv=st.sampled_from(["GATConv", "GATv2Conv", "TransformerConv"]),
    heads=st.integers(1, 3),
    concat=st.booleans(),
    residual=st.booleans(),
    n_layers=st.integers(1, 2),
    distribution=st.sampled_from(["tanh_normal", "normal", "deterministic", "categorical"]),
)
def test_a_batch_equals_one_graph_at_a_time(
    conv: str, heads: int, concat: bool, residual: bool, n_layers: int, distribution: str
) -> None:
    layer = dict(conv=conv, width=3, heads=heads, concat=concat, residual=residual, activation="silu")
    policy = random_policy(record([layer] * n_layers, distribution=distribution))
    observations, masks = random_observations(4, 3, 6), random_masks(4, 3)
    with torch.no_grad():
        batched = policy.distribution(observations, masks)
        for s in range(4):
            alone = policy.distribution(observations[s : s + 1], masks[s : s + 1])
            torch.testing.assert_close(batched.loc[s], alone.loc[0], rtol=1e-5, atol=1e-5)
        if distribution in ("deterministic", "categorical"):
            assert not batched.scale.any()
        else:
            assert (batched.scale > 0).all()
        assert batched.action.abs().max() <= 1.0


def as_layer(name: str) -> str:
    return name.replace("gat.", "layers.0.") if name.startswith("gat.") else name


@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("distribution", ["tanh_normal", "categorical"])
def test_one_layer_of_one_head_takes_the_fast_path_and_equals_the_generic_one(
    residual: bool, distribution: str, tmp_path: Path
) -> None:
    layer = {"conv": "GATv2Conv", "width": 8, "residual": residual, "activation": "tanh"}
    architecture = record([layer], distribution=distribution)
    fast = random_policy(architecture)
    assert isinstance(fast, GraphPolicy)
    network = LayeredNetwork(architecture)
    network.load_state_dict({as_layer(name): tensor for name, tensor in fast.state_dict().items()})
    slow = LayeredPolicy(architecture, network)
    observations, masks = random_observations(5, 4, 6), random_masks(5, 4)
    with torch.no_grad():
        for mask in (None, masks):
            ours, theirs = fast.distribution(observations, mask), slow.distribution(observations, mask)
            torch.testing.assert_close(ours.loc, theirs.loc, rtol=0, atol=1e-5)
            torch.testing.assert_close(ours.scale, theirs.scale, rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(
            fast.attention(observations), slow.attention(observations), rtol=0, atol=1e-5
        )
    save_policy(tmp_path / "fast", fast, name="fast", **CARD)
    loaded, card = load_policy(tmp_path / "fast")
    assert card.architecture == architecture.as_one_layer()
    assert isinstance(loaded, GraphPolicy)
    assert loaded.architecture.residual is residual
    with torch.no_grad():
        assert torch.equal(loaded.distribution(observations).loc, fast.distribution(observations).loc)


@pytest.mark.parametrize(
    "changes",
    [
        {"distribution": "normal"},
        {"graph": {"kind": "radius", "radius": 1.0}},
        {"layers": ({"conv": "GATv2Conv", "width": 8, "activation": "tanh", "heads": 2},)},
        {"layers": ({"conv": "GATConv", "width": 8, "activation": "tanh"},)},
    ],
)
def test_other_architectures_take_the_generic_path(changes: dict[str, Any]) -> None:
    architecture = record([{"conv": "GATv2Conv", "width": 8, "activation": "tanh"}], **changes)
    assert architecture.as_one_layer() is None
    assert isinstance(random_policy(architecture), ModulePolicy)


def test_names_of_tensors_are_unchanged() -> None:
    shapes = weight_shapes(small_policy(6).architecture)
    assert shapes["gat.lin_l.weight"] == (8, 7)
    assert set(shapes) == {
        "encoder.0.weight", "encoder.0.bias", "gat.att", "gat.bias", "gat.lin_l.weight", "gat.lin_l.bias",
        "gat.lin_r.weight", "gat.lin_r.bias", "decoder.0.weight", "decoder.0.bias", "decoder.2.weight",
        "decoder.2.bias",
    }  # fmt: skip
    assert set(weights_of(small_policy(6))) == set(shapes)


@pytest.mark.slow
def test_other_distributions_have_their_actions_and_entries(tmp_path: Path) -> None:
    normal = random_policy(record(TRANSFORMER, distribution="normal"))
    distribution = normal.distribution(random_observations(3, 3, 6))
    assert torch.equal(distribution.action, distribution.loc.clamp(-1, 1))
    save_policy(
        tmp_path / "d", random_policy(record(TRANSFORMER, distribution="deterministic")), name="d", **CARD
    )
    cell = score(
        tmp_path / "d", "attention", episodes=1, timesteps=3, max_cycles=4, behaviour_episodes=0
    ).results[0]
    assert cell.metrics.gef is None
    assert cell.metrics.median_kl is None
    assert "deterministic" in cell.not_measured["comm_gef"]
    assert cell.metrics.fid_plus.value is not None
    assert np.isfinite(cell.metrics.fid_plus.value)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"layers": ()}, "at least 1 item"),
        ({"layers": tuple(GAT2 * 5)}, "at most 8 items"),
        ({"layers": ({**TRANSFORMER[0], "heads": 17},)}, "less than or equal to 16"),
        ({"layers": ({**TRANSFORMER[0], "width": 2048, "heads": 16},)}, "wider than 4096"),
        ({"layers": ({**TRANSFORMER[0], "conv": "os.system"},)}, "'GATConv'"),
        ({"encoder": (10**9,)}, "2048"),
        ({"encoder_activation": "eval"}, "encoder_activation"),
        ({"graph": {"kind": "radius", "radius": -1.0}}, "greater than 0"),
        ({"graph": {"kind": "pickle"}}, "graph"),
        ({"hook": "x"}, "hook"),
    ],
)
def test_records_are_bounded(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        record(GAT2, **changes)


def test_too_many_parameters_are_refused_before_allocation() -> None:
    widest = {"conv": "TransformerConv", "width": 512, "heads": 8, "activation": "tanh"}
    with pytest.raises(InputError, match=r"5\d{8} parameters, more than the limit of 16777216"):
        weight_shapes(record([widest] * 8, encoder=(2048,) * 8, decoder=(2048,) * 8))
