"""Shapes computed by arithmetic equal those of the networks that torch builds."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from xmarl_bench.policy import Architecture, GraphLayer, GraphPolicy, LayeredArchitecture
from xmarl_bench.policy.architecture import EdgeFeatures, Memory
from xmarl_bench.policy.layers import LayeredNetwork
from xmarl_bench.policy.shapes import Shapes, weight_shapes

widths = st.lists(st.integers(1, 9), max_size=3).map(tuple)
layers = st.builds(
    GraphLayer,
    conv=st.sampled_from(["GATConv", "GATv2Conv", "TransformerConv"]),
    width=st.integers(1, 5),
    heads=st.integers(1, 3),
    concat=st.booleans(),
    residual=st.booleans(),
    edges=st.sampled_from([None, EdgeFeatures(position=(0,)), EdgeFeatures(velocity=(0, 0), own="mean")]),
    activation=st.just("tanh"),
)

cells, cell_widths = st.sampled_from(["gru", "lstm"]), st.integers(1, 5)


def memories(n_layers: int) -> st.SearchStrategy[Memory | None]:
    return st.none() | st.builds(Memory, cell=cells, width=cell_widths, after=st.integers(0, n_layers))


def built(network: type[GraphPolicy] | type[LayeredNetwork], architecture: object) -> Shapes:
    with torch.device("meta"):
        state = network(architecture).state_dict()  # type: ignore[arg-type]
    return {name: tuple(tensor.shape) for name, tensor in state.items()}


@given(
    st.integers(1, 7),
    st.integers(1, 3),
    widths,
    st.integers(1, 9),
    widths,
    st.booleans(),
    memories(1),
    st.sampled_from(["tanh_normal", "categorical"]),
)
def test_one_layer(
    obs_dim: int,
    action_dim: int,
    encoder: tuple[int, ...],
    gat_width: int,
    decoder: tuple[int, ...],
    residual: bool,
    memory: Memory | None,
    distribution: Any,
) -> None:
    architecture = Architecture(
        obs_dim=obs_dim, action_dim=action_dim, encoder=encoder, encoder_activation="relu",
        gat_width=gat_width, gat_activation="tanh", decoder=decoder, decoder_activation="elu",
        residual=residual, memory=memory, distribution=distribution,
    )  # fmt: skip
    assert weight_shapes(architecture) == built(GraphPolicy, architecture)


@given(
    widths,
    st.lists(layers, min_size=1, max_size=3).map(tuple),
    widths,
    st.sampled_from(["tanh_normal", "normal", "deterministic", "categorical"]),
    st.data(),
)
def test_layers(
    encoder: tuple[int, ...],
    layers: tuple[GraphLayer, ...],
    decoder: tuple[int, ...],
    distribution: str,
    data: st.DataObject,
) -> None:
    architecture = LayeredArchitecture.model_validate(
        {
            "obs_dim": 4,
            "encoder": encoder,
            "layers": layers,
            "memory": data.draw(memories(len(layers))),
            "decoder": decoder,
            "distribution": distribution,
        }
    )
    assert weight_shapes(architecture) == built(LayeredNetwork, architecture)


@pytest.mark.slow
def test_shapes_do_not_import_torch() -> None:
    code = (
        "import sys, xmarl_bench.policy.bundle;"
        "assert not {'torch', 'torch_geometric', 'scipy'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
