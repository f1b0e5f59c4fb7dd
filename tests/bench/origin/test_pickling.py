"""Objects reach other processes with the code that torch_geometric generates for their layers."""

from __future__ import annotations

import importlib.util
import pickle
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv, MessagePassing, Sequential

from xmarl_bench.origin.code_hash import object_sha256
from xmarl_bench.origin.pickling import dumps, is_generated

EDGES = torch.tensor([[0, 1, 1], [1, 0, 1]])


def sequential() -> nn.Module:
    steps = [(GATv2Conv(3, 4), "x, edge_index -> x"), nn.Tanh()]
    network: nn.Module = Sequential("x, edge_index", steps)
    return network


def own_layer() -> nn.Module:
    class Sum(MessagePassing):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(aggr="add")
            self.linear = nn.Linear(3, 4)

        def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
            return torch.as_tensor(self.propagate(edge_index, x=self.linear(x)))

        def message(self, x_j: Tensor) -> Tensor:
            return x_j

    network: nn.Module = Sum()
    return network


@pytest.mark.parametrize("make", [sequential, own_layer])
def test_a_network_is_loaded_where_its_generated_modules_do_not_exist(
    make: Callable[[], nn.Module], monkeypatch: pytest.MonkeyPatch
) -> None:
    network = make()
    sent = dumps(network)
    generated = [name for name in [*sys.modules] if is_generated(name)]  # a finder may import
    assert generated
    for name in generated:
        monkeypatch.delitem(sys.modules, name)
    x = torch.rand(2, 3)
    assert torch.equal(pickle.loads(sent)(x, EDGES), network(x, EDGES))


@pytest.mark.parametrize("make", [sequential, own_layer])
def test_the_hash_of_a_network_does_not_depend_on_where_its_code_was_generated(
    make: Callable[[], nn.Module],
) -> None:
    def sha256() -> str | None:
        torch.manual_seed(0)
        return object_sha256(make())

    before = sha256()
    with tempfile.NamedTemporaryFile("w", suffix=".py") as other:  # beside the generated modules
        Path(other.name).write_text("x = 1")
        assert sha256() == before is not None


def test_modules_with_a_name_of_their_own_are_not_generated() -> None:
    sequential()
    assert not any(map(is_generated, ("torch_geometric.nn.sequential", "torch", "pickle", __name__, "sys")))


def test_odd_entries_among_the_loaded_modules_do_no_harm(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "alone.py").write_text("def own():\n    return 3")
    spec = importlib.util.spec_from_file_location("no_parent.alone", tmp_path / "alone.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setitem(sys.modules, "no_parent.alone", module)
    monkeypatch.setitem(sys.modules, "never", None)
    sent = dumps(module.own)
    monkeypatch.delitem(sys.modules, "no_parent.alone")
    assert pickle.loads(sent)() == 3
