"""Memories of the closed list: cells by hand, on both paths, saved and loaded, and from another library."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from pydantic import ValidationError
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv

from tests.conftest import RunCli
from tests.helpers.policies import random_masks, random_observations, small_policy
from tests.helpers.recurrent_policies import (
    ONE_LAYER,
    TWO_LAYERS,
    random_weights,
    recurrent_policy,
    remembering,
)
from xmarl_bench.policy import (
    Architecture,
    GraphPolicy,
    LayeredArchitecture,
    complete_graph,
    load_policy,
    save_policy,
)
from xmarl_bench.policy.architecture import Memory
from xmarl_bench.policy.build import LayeredPolicy
from xmarl_bench.policy.layers import LayeredNetwork
from xmarl_bench.policy.memory import remember

CARD: dict[str, Any] = {"task": "blind_navigation_v0", "n_agents": 3, "attention_entropy": 0.0}
CELLS = pytest.mark.parametrize("cell", ["gru", "lstm"])
Array = NDArray[np.float64]


def sigmoid(x: Array) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-x)))


def gru_by_hand(w: dict[str, Array], x: Array, h: Array) -> tuple[Array, Array]:
    """Cho et al. (2014) as in torch: the reset gate scales the hidden half of the candidate."""
    r_x, z_x, n_x = np.split(w["weight_ih"] @ x + w["bias_ih"], 3)
    r_h, z_h, n_h = np.split(w["weight_hh"] @ h + w["bias_hh"], 3)
    reset, update = sigmoid(r_x + r_h), sigmoid(z_x + z_h)
    after = (1.0 - update) * np.tanh(n_x + reset * n_h) + update * h
    return after, after


def lstm_by_hand(w: dict[str, Array], x: Array, memory: Array) -> tuple[Array, Array]:
    """Hochreiter and Schmidhuber (1997) with a forget gate; a memory is [h, c]."""
    h, c = np.split(memory, 2)
    i, f, g, o = np.split(w["weight_ih"] @ x + w["bias_ih"] + w["weight_hh"] @ h + w["bias_hh"], 4)
    c = sigmoid(f) * c + sigmoid(i) * np.tanh(g)
    h = sigmoid(o) * np.tanh(c)
    return h, np.concatenate([h, c])


BY_HAND = {"gru": gru_by_hand, "lstm": lstm_by_hand}


@CELLS
def test_a_cell_equals_the_written_out_formula(cell: str) -> None:
    record = Memory.model_validate({"cell": cell, "width": 4})
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        module = (nn.GRUCell if cell == "gru" else nn.LSTMCell)(3, 4)
    weights = {name: tensor.detach().double().numpy() for name, tensor in module.state_dict().items()}
    x, memory = random_observations(6, 2, 3), random_observations(2, 1, record.size, seed=1)[:, 0]
    with torch.no_grad():
        output, after = remember(record, module, 0, x, memory)  # the memory has no axis of timesteps
        assert remember(record, module, 1, x, memory) == (x, memory)
    for s, i in np.ndindex(6, 2):
        expected = BY_HAND[cell](weights, x[s, i].double().numpy(), memory[i].double().numpy())
        np.testing.assert_allclose(output[s, i].numpy(), expected[0], rtol=0, atol=1e-6)
        np.testing.assert_allclose(after[s, i].numpy(), expected[1], rtol=0, atol=1e-6)


@CELLS
@pytest.mark.parametrize("after", [0, 1], ids=["before attention", "after attention"])
def test_the_fast_path_equals_the_generic_one(cell: str, after: int) -> None:
    architecture = remembering(cell, after)
    fast = recurrent_policy(architecture)
    network = LayeredNetwork(architecture)
    network.load_state_dict(random_weights(architecture))
    slow = LayeredPolicy(architecture, network)
    assert isinstance(fast, GraphPolicy)
    assert fast.row_wise
    assert slow.row_wise
    assert fast.memory_dim == slow.memory_dim == (5 if cell == "gru" else 10)
    observations = random_observations(6, 4, 6 + fast.memory_dim)
    masks = torch.stack([random_masks(6, 4, seed) for seed in range(2)])
    with torch.no_grad():
        for mask in (None, masks[0], masks):
            (ours, memory), (theirs, other) = fast.step(observations, mask), slow.step(observations, mask)
            torch.testing.assert_close(ours.loc, theirs.loc, rtol=0, atol=1e-5)
            torch.testing.assert_close(ours.scale, theirs.scale, rtol=1e-5, atol=1e-5)
            torch.testing.assert_close(memory.expand_as(other), other, rtol=0, atol=1e-5)
            assert torch.equal(fast.distribution(observations, mask).loc, ours.loc)
            assert torch.equal(slow.distribution(observations, mask).loc, theirs.loc)
        torch.testing.assert_close(
            fast.attention(observations), slow.attention(observations), rtol=0, atol=1e-5
        )
        for x in observations:
            one, two = fast(x, complete_graph(4)), slow(x, complete_graph(4))
            torch.testing.assert_close(one, two, rtol=0, atol=1e-5)


@CELLS
@pytest.mark.parametrize("after", [0, 1, 2])
def test_a_memory_runs_at_its_place_between_layers(cell: str, after: int) -> None:
    """Compared with two layers and a cell of torch_geometric and torch, called one after the other."""
    policy = recurrent_policy(remembering(cell, after, TWO_LAYERS))
    assert isinstance(policy, LayeredPolicy)
    assert not policy.row_wise
    network, edges = policy.network, complete_graph(3)
    assert isinstance(network, LayeredNetwork)
    observations = random_observations(4, 3, 6 + policy.memory_dim)
    with torch.no_grad():
        distribution, memory = policy.step(observations)
        for s, row in enumerate(observations):
            hidden, state = network.encoder(row[:, :6]), row[:, 6:]
            for place in range(3):
                if place > 0:
                    hidden = network.layers[place - 1](hidden, edges)
                    hidden = network.activations[place - 1](hidden)
                if place == after and isinstance(network.memory, nn.GRUCell):
                    hidden = state = network.memory(hidden, state)
                elif place == after:
                    assert network.memory is not None
                    hidden, c = network.memory(hidden, (state[:, :5], state[:, 5:]))
                    state = torch.cat([hidden, c], dim=-1)
            loc = network.decoder(hidden)[:, :2]
            torch.testing.assert_close(distribution.loc[s], loc, rtol=0, atol=1e-5)
            torch.testing.assert_close(memory[s], state, rtol=0, atol=1e-5)


@CELLS
@pytest.mark.parametrize("after", [0, 1])
def test_messages_reach_only_the_memory_of_their_receiver(cell: str, after: int) -> None:
    """A memory before the layer keeps the agent's own observations; one after it keeps messages."""
    policy = recurrent_policy(remembering(cell, after))
    observations, mask = random_observations(1, 4, 6 + policy.memory_dim), torch.ones(1, 4, 4)
    mask[0, 1, 2] = 0.0  # the message 2 -> 1
    with torch.no_grad():
        full, masked = policy.step(observations), policy.step(observations, mask)
    acts = (masked[0].loc - full[0].loc)[0].abs().sum(dim=-1)
    remembers = (masked[1] - full[1])[0].abs().sum(dim=-1)
    assert acts[1] > 1e-4
    assert acts[[0, 2, 3]].max() == 0.0
    assert (remembers[1] > 1e-4) == (after == 1)
    assert remembers[[0, 2, 3]].max() == 0.0


@CELLS
@pytest.mark.parametrize("layers", [ONE_LAYER, TWO_LAYERS], ids=["fast", "generic"])
def test_memories_are_saved_and_loaded(cell: str, layers: tuple[dict[str, Any], ...], tmp_path: Path) -> None:
    policy = recurrent_policy(remembering(cell, 1, layers))
    saved = save_policy(tmp_path, policy, name="mine", **CARD)
    loaded, card = load_policy(tmp_path)
    assert card == saved
    assert card.architecture == policy.architecture
    observations = random_observations(3, 3, 6 + policy.memory_dim)
    with torch.no_grad():
        assert torch.equal(loaded.step(observations)[1], policy.step(observations)[1])
    assert torch.equal(loaded.initial_state(3), torch.zeros(3, policy.memory_dim))


def test_records_without_memory_are_written_as_before() -> None:
    assert "memory" not in small_policy(6).architecture.model_dump()
    assert small_policy(6).memory_dim == 0
    observations = random_observations(2, 3, 6)
    distribution, memory = small_policy(6).step(observations)
    assert torch.equal(distribution.loc, small_policy(6).distribution(observations).loc)
    assert memory.shape == (2, 3, 0)


def test_a_memory_after_a_missing_layer_is_refused() -> None:
    with pytest.raises(ValidationError, match="after layer 2, but there are 1"):
        remembering("gru", 2)
    with pytest.raises(ValidationError, match="after layer 2, but there are 1"):
        Architecture.model_validate(
            {**small_policy(6).architecture.model_dump(), "memory": dict(cell="gru", width=3, after=2)}
        )
    with pytest.raises(ValidationError, match="'gru' or 'lstm'"):
        remembering("rnn", 0)


def torchrl_key_map(cell: str) -> dict[str, str]:
    """Of the actor below."""
    names = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
    of_cell = {f"rnn.{cell}.{name}_l0": f"memory.{name}" for name in names}
    return {"gnn.": "layers.0.", **of_cell, "mlp.": "decoder."}


class TorchRLActor(nn.Module):
    """A graph layer, then TorchRL's own GRU or LSTM, its MLP and its head."""

    def __init__(self, cell: str) -> None:
        from torchrl.modules import (  # takes a second, and only this test needs it
            MLP,
            GRUModule,
            LSTMModule,
            NormalParamExtractor,
        )

        super().__init__()
        self.gnn = GATv2Conv(6, 8, add_self_loops=False)
        states = ["h"] if cell == "gru" else ["h", "c"]
        self.rnn = (GRUModule if cell == "gru" else LSTMModule)(
            input_size=8,
            hidden_size=5,
            in_keys=["heard", *states, "is_init"],
            out_keys=["out", *(("next", state) for state in states)],
        )
        self.mlp = MLP(in_features=5, out_features=4, num_cells=[9], activation_class=nn.Tanh)
        self.head = NormalParamExtractor()

    def forward(self, x: Tensor, memory: Tensor, *, first: bool) -> tuple[Tensor, Tensor, Tensor]:
        n, states = len(x), [state[:, None] for state in memory.split(5, dim=1)]
        heard = self.gnn(x, complete_graph(n))
        out, *after = self.rnn(heard, *states, torch.full((n, 1), first))
        loc, scale = self.head(self.mlp(out))
        return loc, scale, torch.cat([state[:, 0] for state in after], dim=-1)


@pytest.mark.slow
@CELLS
def test_a_recurrent_actor_of_torchrl(cell: str, tmp_path: Path, run_cli: RunCli) -> None:
    torch.manual_seed(0)
    actor = TorchRLActor(cell)
    torch.save(actor.state_dict(), tmp_path / "actor.pt")
    architecture = LayeredArchitecture.model_validate(
        {
            "obs_dim": 6,
            "layers": ({"conv": "GATv2Conv", "width": 8, "activation": "identity"},),
            "memory": {"cell": cell, "width": 5, "after": 1},
            "decoder": (9,),
            "decoder_activation": "tanh",
            "scale": "torchrl",
        }
    )
    (tmp_path / "a.json").write_text(json.dumps(architecture.model_dump()))
    (tmp_path / "m.json").write_text(json.dumps(torchrl_key_map(cell)))
    ran = run_cli(
        "convert", tmp_path / "actor.pt", "--out", tmp_path / "rl", "--task", "blind_navigation_v0",
        "--architecture", tmp_path / "a.json", "--key-map", tmp_path / "m.json",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    policy, _ = load_policy(tmp_path / "rl")
    ours = theirs = policy.initial_state(3)
    with torch.no_grad():
        for t, x in enumerate(random_observations(4, 3, 6)):
            loc, scale, theirs = actor(x, theirs, first=t == 0)
            distribution, (ours,) = policy.step(torch.cat([x, ours], dim=-1)[None])
            torch.testing.assert_close(distribution.loc[0], loc, rtol=0, atol=1e-5)
            torch.testing.assert_close(distribution.scale[0], scale, rtol=0, atol=1e-5)
            torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-5)
