"""The hash of own code differs if its result would differ, and is the same in every process."""

from __future__ import annotations

import functools
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent
from typing import Literal

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import SimpleConv

from xmarl_bench import PolicyModule, as_explainer
from xmarl_bench.origin import code_hash
from xmarl_bench.origin.code_hash import object_sha256
from xmarl_bench.origin.references import load_reference, origin_of
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.policy import Policy
from xmarl_bench.scoring.piece_keys import Keys

SCALE = 0.5
TAGS = {"near", "far", "left", "right"}  # its order differs between processes


def closure(scale: float) -> Callable[[Tensor, Policy], Tensor]:
    def explain(observations: Tensor, policy: Policy) -> Tensor:
        return scale * policy.attention(observations)

    return explain


def by_default(observations: Tensor, policy: Policy, scale: float = 1.0) -> Tensor:
    return scale * policy.attention(observations)


def by_global(observations: Tensor, policy: Policy) -> Tensor:
    return SCALE * policy.attention(observations)


class WithTensor:
    def __init__(self, value: float) -> None:
        self.weight = torch.full((2, 2), value)

    def explain(self, observations: Tensor, policy: Policy) -> Tensor:
        return self.weight.mean() * policy.attention(observations)


class Network(nn.Module):
    def __init__(self, scale: float) -> None:
        super().__init__()
        self.scale, self.layer = scale, SimpleConv()

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        heard: Tensor = self.layer(x[:, :4], edge_index)
        return self.scale * heard


def differ_by_themselves(make: Callable[[float], object]) -> None:
    hashes = [object_sha256(make(value)) for value in (0.25, 0.5, 0.25)]
    assert None not in hashes
    assert hashes[0] == hashes[2] != hashes[1]


@pytest.mark.parametrize(
    "make",
    [
        closure,
        lambda scale: functools.partial(by_default, scale=scale),
        lambda scale: functools.update_wrapper(functools.partial(by_default, scale=scale), by_default),
        lambda scale: eval(f"lambda observations, policy, scale={scale}: scale"),
        WithTensor,
    ],
    ids=["closure", "partial", "named partial", "lambda", "tensor"],
)
def test_values_in_an_explainer_change_the_hash(make: Callable[[float], object]) -> None:
    differ_by_themselves(lambda value: as_explainer(make(value), name="own"))


def test_a_float_in_a_policy_s_network_changes_the_hash() -> None:
    Network(0.0)  # torch_geometric completes a layer's class when the first is made, which is hashed
    keys = []
    for scale in (0.25, 0.5, 0.25):
        module = PolicyModule("own", Network(scale), "blind_navigation_v0", 3)
        keys.append(Keys().policy(*open_module(module, origin_of(module.network))))
    assert keys[0] == keys[2] != keys[1]


def test_the_first_layer_of_a_class_has_the_hash_of_later_ones() -> None:
    class Layer(SimpleConv):  # type: ignore[misc]
        pass

    assert object_sha256(Layer()) == object_sha256(Layer()) is not None


def test_the_hash_does_not_depend_on_which_equal_strings_are_one_object() -> None:
    word = "long enough"
    other = "".join(["long ", "enough"])
    assert word is not other
    assert object_sha256([word, word]) == object_sha256([word, other]) != object_sha256([word, "else"])
    assert object_sha256(["", "\udce4"]) == object_sha256(["", "\udce4"]) is not None


def test_a_global_changes_the_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    before = object_sha256(by_global)
    assert before is not None
    monkeypatch.setitem(globals(), "SCALE", 0.75)
    assert object_sha256(by_global) != before


def by_library(observations: Tensor) -> object:
    return np.asarray(observations)


def test_the_version_of_a_library_that_code_calls_changes_the_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    before = object_sha256(by_library), object_sha256(by_global)
    monkeypatch.setattr(code_hash, "package_version", {"numpy": "99"}.get)
    assert object_sha256(by_library) not in (None, before[0])
    assert object_sha256(by_library) == object_sha256(by_library)


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_large_array_is_hashed_by_its_values(order: Literal["C", "F"]) -> None:
    array = np.zeros((1000, 100), order=order)
    before = object_sha256(array)
    assert before == object_sha256(array.copy(order=order)) is not None
    array[-1, -1] = 1.0
    assert object_sha256(array) not in (before, None)


def test_an_object_that_cannot_be_pickled_has_no_hash_and_is_not_cached() -> None:
    explainer = as_explainer(closure(sys.stdout), name="own")  # type: ignore[arg-type]
    assert object_sha256(explainer) is None
    keys = Keys()
    assert keys.explainer(explainer) == keys.explainer(explainer) != Keys().explainer(explainer)


OWN = """
    from helper import scaled

    NAMES = {"one", "two", "three", "four"}

    class Own:
        def explain(self, observations, policy):
            assert "one" in NAMES
            return scaled(policy.attention(observations))

    def lazy(observations, policy):
        import helper
        return helper.scaled(observations)

    own = Own()
    """


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "own.py").write_text(dedent(OWN))
    (tmp_path / "helper.py").write_text("def scaled(x):\n    return 0.25 * x\n")
    return tmp_path


@pytest.mark.parametrize("name", ["own", "Own", "lazy"])
def test_an_edit_of_a_module_beside_a_file_changes_the_hash(name: str, folder: Path) -> None:
    def now() -> str | None:
        return object_sha256(load_reference(f"{folder / 'own.py'}:{name}")[0])

    before = now()
    assert before is not None
    assert now() == before
    (folder / "helper.py").write_text("def scaled(x):\n    return 0.75 * x\n")
    own, _ = load_reference(f"{folder / 'own.py'}:scaled")
    assert own(1.0) == 0.75
    assert now() != before
    assert str(folder) not in sys.path


def test_a_module_edited_after_its_import_has_another_hash(folder: Path) -> None:
    """Otherwise a result of the old code would be stored as one of the new code."""
    old, _ = load_reference(f"{folder / 'own.py'}:own")
    (folder / "helper.py").write_text("def scaled(x):\n    return 0.75 * x\n")
    stale = object_sha256(old)
    new, _ = load_reference(f"{folder / 'own.py'}:own")
    assert stale != object_sha256(new)


def test_folders_with_modules_of_one_name_are_kept_apart(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    other = tmp_path_factory.mktemp("other")
    (other / "own.py").write_text((folder / "own.py").read_text())
    (other / "helper.py").write_text("def scaled(x):\n    return 0.75 * x\n")
    found = [load_reference(f"{each / 'own.py'}:scaled")[0](1.0) for each in (folder, other, folder)]
    assert found == [0.25, 0.75, 0.25]
    assert "helper" not in sys.modules


@pytest.mark.slow
def test_two_processes_agree(folder: Path) -> None:
    code = (
        "import sys; from xmarl_bench.origin.references import load_reference\n"
        "from xmarl_bench.origin.code_hash import object_sha256\n"
        f"own = load_reference({str(folder / 'own.py')!r} + ':own')[0]\n"
        f"print(object_sha256([own, {sorted(TAGS)}, set({sorted(TAGS)})]))"
    )
    other = subprocess.run(
        [sys.executable, "-c", code], env={"PYTHONHASHSEED": "1", "PYTHONPATH": ":".join(sys.path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    own, _ = load_reference(f"{folder / 'own.py'}:own")
    here = object_sha256([own, sorted(TAGS), TAGS])
    assert here is not None
    assert object_sha256([own, sorted(TAGS), TAGS | {"more"}]) != here
    assert other.stdout == f"{here}\n"
