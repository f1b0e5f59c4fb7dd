"""BenchMARL's config.pkl is read without unpickling it. Classes here stand in for those of BenchMARL."""

from __future__ import annotations

import contextlib
import io
import pickle
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from torch import nn
from torch_geometric.nn import GATv2Conv, TransformerConv

from tests.bench.policy.test_hostile_bundles import RAN, Payload
from xmarl_bench.errors import InputError
from xmarl_bench.policy.benchmarl import Settings
from xmarl_bench.policy.benchmarl_config import completed
from xmarl_bench.policy.pickled_records import PickledName, PickledRecord, read_records


@dataclass
class Gnn:
    self_loops: bool = False
    gnn_kwargs: Any = None
    gnn_class: Any = GATv2Conv
    topology: str = "full"
    edge_radius: float | None = None


@dataclass
class Mlp:
    activation_class: Any = nn.Tanh
    activation_kwargs: Any = None


@dataclass
class Sequence:
    model_configs: list[Any]


@dataclass
class Algorithm:
    scale_mapping: str = "softplus"
    use_tanh_normal: bool = True


def pickled(*values: object) -> bytes:
    file = io.BytesIO()
    for value in values:
        pickle.dump(value, file)
    return file.getvalue()


CONFIG = pickled("task", {}, Algorithm(), Sequence([Gnn(), Mlp()]), 0)


def checkpoint(folder: Path, config: bytes) -> Path:
    (folder / "config.pkl").write_bytes(config)
    return folder / "checkpoints" / "checkpoint_60.pt"


def test_records_hold_what_was_pickled() -> None:
    values = [
        {"a": [1, -2, 3.5, None], 7: (True, "x", (), [])},
        [2**40],
        Mlp(nn.ReLU, {"inplace": True}),
        300,
    ]
    *plain, record, last = read_records(pickled(*values))
    assert (plain, last) == (values[:2], 300)
    assert record == PickledRecord(
        PickledName(__name__, "Mlp"),
        {
            "activation_class": PickledName("torch.nn.modules.activation", "ReLU"),
            "activation_kwargs": {"inplace": True},
        },
    )


def test_nothing_is_executed(tmp_path: Path) -> None:
    read_records(pickled(Payload()))
    hostile = pickled("task", Payload(), Algorithm(), Sequence([Payload(), Gnn()]))
    completed(Settings(), checkpoint(tmp_path, hostile))
    assert RAN == []


@given(st.integers(0, len(CONFIG) - 1), st.binary(min_size=1, max_size=3))
def test_damaged_files_end_in_values_or_one_error(place: int, inserted: bytes) -> None:
    with contextlib.suppress(ValueError):
        read_records(CONFIG[:place] + inserted + CONFIG[place + len(inserted) :])
    assert RAN == []


def test_values_that_would_grow_without_bounds_do_not() -> None:
    """Each of 60 tuples holds the one before twice: 2^60 values if any were visited."""
    value: Any = ()
    for _ in range(60):
        value = (value, value)
    assert len(read_records(pickle.dumps(value))) == 1
    steps = b"".join(b"h%ch%c\x86\x94" % (k, k) for k in range(60))  # get k twice, make a tuple, remember it
    for end, said in ((b"}h<K\x01s.", "neither text nor number"), (b"h<h<\x93.", "a name that is not text")):
        with pytest.raises(ValueError, match=said):
            read_records(b"\x80\x04)\x94" + steps + end)


@pytest.mark.parametrize(
    ("models", "expected"),
    [
        ([Gnn(), Mlp()], Settings("tanh", "layer", "softplus", True, radius=inf)),
        (
            [Mlp(), Gnn(True, {"add_self_loops": False, "heads": 2})],
            Settings("tanh", "graph", "softplus", True, radius=inf),
        ),
        (
            [Gnn(False, {"add_self_loops": False}, topology="from_pos", edge_radius=0.5)],
            Settings(None, "none", "softplus", True, radius=0.5),
        ),
        (
            [Gnn(False, {}, TransformerConv), Mlp(nn.SiLU)],
            Settings("silu", "none", "softplus", True, radius=inf),
        ),
    ],
)
def test_settings_by_hand(models: list[Any], expected: Settings, tmp_path: Path) -> None:
    model = models[0] if len(models) == 1 else Sequence(models)
    path = checkpoint(tmp_path, pickled("task", {}, Algorithm(), model))
    assert completed(Settings(), path) == expected
    given_ones = Settings("relu", "none", "biased_softplus", False, "agents", (1,), (0,), (2,), 3.0)
    assert completed(given_ones, path) == given_ones


@pytest.mark.parametrize("config", [None, b"", b"x", CONFIG[:40], pickled(1, 2, 3, 4), pickled(1)])
def test_other_files_leave_the_options_to_the_user(config: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "checkpoints" / "c.pt" if config is None else checkpoint(tmp_path, config)
    assert completed(Settings(activation="elu"), path) == Settings(activation="elu")


@pytest.mark.parametrize(
    ("models", "said"),
    [
        ([Gnn(gnn_kwargs={"negative_slope": 0.1})], "has gnn_kwargs 'negative_slope'"),
        ([Gnn(gnn_kwargs=[1])], "an unknown value"),
        ([Gnn(topology="from_pos")], "the topology 'from_pos'"),
        ([Gnn(topology="empty")], "the topology 'empty'"),
        ([Gnn(), Gnn(topology="from_pos", edge_radius=0.5)], "different topologies"),
        ([Gnn(), Gnn(gnn_kwargs={"add_self_loops": False})], "only some of the actor's GNNs"),
        ([Gnn(), Mlp(nn.GELU)], "functions 'GELU', and a bundle has one of Tanh, "),
        ([Mlp(), Gnn(), Mlp(nn.ReLU)], "functions 'ReLU, Tanh'"),
        ([Gnn(), Mlp(nn.LeakyReLU, {"negative_slope": 0.1})], "'LeakyReLU' with arguments"),
    ],
)
def test_what_a_bundle_cannot_express_is_refused(models: list[Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        completed(Settings(), checkpoint(tmp_path, pickled("task", {}, Algorithm(), Sequence(models))))
