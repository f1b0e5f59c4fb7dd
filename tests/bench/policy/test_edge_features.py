"""Edge features from positions and velocities, as a bundle describes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from pydantic import ValidationError

from tests.bench.policy.test_layers import CARD, random_policy, record
from tests.helpers.policies import random_masks, random_observations
from xmarl_bench import CompleteGraph, load_policy, save_policy, score
from xmarl_bench.policy import complete_graph
from xmarl_bench.policy.architecture import EdgeFeatures
from xmarl_bench.policy.edge_features import edge_features
from xmarl_bench.submission.consistency import entry_findings

PLACE = {"position": (0, 1)}
MOTION = {"position": (0, 1), "velocity": (2, 3), "own": "mean"}


def layer(edges: dict[str, Any] | None, conv: str = "GATv2Conv") -> dict[str, Any]:
    return {"conv": conv, "width": 4, "heads": 2, "activation": "tanh", "edges": edges}


def test_features_by_hand() -> None:
    x = torch.zeros(3, 6)
    x[:, :2] = torch.tensor([[0.0, 0.0], [3.0, 4.0], [0.0, 8.0]])
    x[:, 2] = torch.tensor([1.0, 0.5, 0.0])
    edges = torch.tensor([[1, 0, 0, 2], [0, 1, 0, 0]])  # 1 -> 0, 0 -> 1, 0 -> 0, 2 -> 0
    from_1, from_0, from_2 = [3.0, 4.0, 5.0], [-3.0, -4.0, 5.0], [0.0, 8.0, 8.0]
    place = EdgeFeatures(position=(0, 1))
    assert edge_features(place, x, edges).tolist() == [from_1, from_0, [0.0] * 3, from_2]
    mean = edge_features(place.model_copy(update={"own": "mean"}), x, edges)
    assert mean.tolist() == [from_1, from_0, [1.5, 6.0, 6.5], from_2]
    motion = EdgeFeatures(position=(1,), velocity=(2, 0))
    assert edge_features(motion, x, edges)[0].tolist() == [4.0, 4.0, -0.5, 3.0]
    lonely = edge_features(place.model_copy(update={"own": "mean"}), x, torch.tensor([[2], [2]]))
    assert lonely.tolist() == [[0.0] * 3]


def test_one_head_of_gatv2_equals_the_formula() -> None:
    edges = {"conv": "GATv2Conv", "width": 4, "activation": "identity", "edges": PLACE}
    policy = random_policy(record([edges]))
    x, mask = random_observations(1, 3, 6), random_masks(1, 3)
    network = policy.network
    with torch.no_grad():
        hidden = network.encoder(x[0])
        gat = network.layers[0]
        features = edge_features(EdgeFeatures(position=(0, 1)), x[0], complete_graph(3)).view(3, 3, 3)
        pair = gat.lin_r(hidden)[:, None] + gat.lin_l(hidden)[None] + features @ gat.lin_edge.weight.T
        alpha = torch.softmax(torch.nn.functional.leaky_relu(pair, 0.2) @ gat.att.view(-1), dim=1)
        raw = network.decoder((mask[0] * alpha) @ gat.lin_l(hidden) + gat.bias)
        torch.testing.assert_close(policy.attention(x)[0], alpha, rtol=0, atol=1e-5)
        torch.testing.assert_close(policy.distribution(x, mask).loc[0], raw[:, :2], rtol=0, atol=1e-5)


def test_invalid_features_are_refused() -> None:
    for edges in ({}, {"position": (0, 6)}, {"velocity": (-1,)}, {"position": (0,) * 9}):
        with pytest.raises(ValidationError):
            record([layer(edges)])


def test_records_without_edge_features_are_written_as_before() -> None:
    assert "edges" not in record([layer(None)]).model_dump_json()


@pytest.mark.slow
@pytest.mark.parametrize("conv", ["GATConv", "GATv2Conv", "TransformerConv"])
def test_bundles_are_saved_loaded_and_scored(conv: str, tmp_path: Path) -> None:
    graph = CompleteGraph(loops=conv == "GATv2Conv")
    policy = random_policy(record([layer(MOTION, conv), layer(PLACE, conv)], graph=graph))
    save_policy(tmp_path / "p", policy, name="p", **CARD)
    loaded, card = load_policy(tmp_path / "p")
    assert card.architecture == policy.architecture
    x = random_observations(3, 3, 6)
    moved = x.clone()
    moved[..., 3] += torch.arange(3)  # velocities of the others
    with torch.no_grad():
        assert torch.equal(loaded.distribution(x).loc, policy.distribution(x).loc)
        assert not torch.allclose(loaded.attention(moved), loaded.attention(x), atol=1e-4)
    entry = score(tmp_path / "p", "attention", episodes=1, timesteps=3, max_cycles=5, behaviour_episodes=0)
    assert list(entry_findings(entry)) == []
    assert entry.results[0].metrics.fid_delta.value is not None
