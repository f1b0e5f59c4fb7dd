"""References `path/to/file.py:Name` and `module:Name` are loaded and recorded, or refused."""

from __future__ import annotations

import hashlib
import json
import pickle
import sys
from pathlib import Path
from typing import Any

import cloudpickle
import pytest
import torch

from tests.conftest import MakeBundle, RunCli
from xmarl_bench.entry.file import read_entries
from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import as_explainer, origin_of_explainer
from xmarl_bench.origin.references import Origin, is_reference, load_reference, origin_of
from xmarl_bench.plugins.registry import find_explainer

CODE = '''
from __future__ import annotations
from dataclasses import dataclass
import torch

def nearest(observations, policy):
    """The nearer, the more it matters."""
    return torch.exp(-torch.cdist(observations[..., :2], observations[..., :2]))

@dataclass
class Scaled:
    scale: float = 0.5
    accesses = "black-box"

    def explain(self, observations):
        return self.scale * nearest(observations, None)

half = Scaled(0.25)
'''
QUICK = ("--episodes", 2, "--max-cycles", 6, "--timesteps", 2, "--behaviour-episodes", 0)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "own.py"
    path.write_text(CODE)
    return path


def test_functions_classes_and_objects_of_a_file_are_loaded(file: Path) -> None:
    digest = hashlib.sha256(CODE.encode()).hexdigest()
    for name, known, scale in (
        ("nearest", "nearest", None),
        ("Scaled", "scaled", 0.5),
        ("half", "scaled", 0.25),
    ):
        explainer = find_explainer(f"{file}:{name}")
        assert explainer.name == known
        assert explainer.origin == Origin(None, None, f"own.py:{name}", digest)
        assert explainer.hyperparameters.get("scale") == scale


@pytest.mark.parametrize(
    "command", [("evaluate", "--policy"), ("check", "explainer"), ("render", "--policy")]
)
def test_a_file_without_a_name_is_refused_and_not_run(
    command: tuple[str, ...], file: Path, run_cli: RunCli
) -> None:
    file.write_text(
        CODE + "_own: int = 1\nother: int = 2\n(one, two), half.scale = (3, 4), 5\nraise SystemExit(7)\n"
    )
    ran = run_cli(*command, file)
    assert (ran.code, ran.out) == (2, "")
    names = "nearest, Scaled, half, other, one, two"
    said = f"{file} is a file of code: give {file}:NAME with one of its names: {names}."
    assert ran.err == f"xmarl-bench: {said}\n"
    for content, problem in (("def", "is not Python"), ("\0", "is not Python"), ("", "its names: none.")):
        file.write_text(content)
        assert problem in run_cli(*command, file).err
    file.unlink()
    assert "cannot be read (No such file or directory)" in run_cli(*command, file).err


@pytest.mark.slow
def test_a_module_s_origin_is_its_package() -> None:
    explainer = find_explainer("torch_geometric.explain:DummyExplainer")
    assert explainer.name == "dummy-explainer"
    origin = origin_of_explainer(explainer)
    assert (origin.distribution, origin.code_sha256) == ("torch-geometric", None)
    assert origin_of(Path).code_sha256 is None or origin_of(Path).distribution is None
    assert not is_reference("attention")


def test_a_changed_file_is_loaded_again(file: Path) -> None:
    first, origin = load_reference(f"{file}:half")
    file.write_text(CODE.replace("0.25", "0.75"))
    second, changed = load_reference(f"{file}:half")
    assert (first.scale, second.scale) == (0.25, 0.75)
    assert origin.code_sha256 != changed.code_sha256


def test_two_files_of_one_name_are_kept_apart(file: Path, tmp_path: Path) -> None:
    other = tmp_path / "deeper" / "own.py"
    other.parent.mkdir()
    other.write_text(CODE.replace("0.25", "0.75"))
    scales = [load_reference(f"{path}:half")[0].scale for path in (file, other, file)]
    assert scales == [0.25, 0.75, 0.25]


def test_what_a_file_defines_is_pickled_with_its_code(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    half, _ = load_reference(f"{file}:half")
    sent = cloudpickle.dumps(half)
    monkeypatch.delitem(sys.modules, type(half).__module__)
    file.unlink()
    assert pickle.loads(sent).explain(torch.zeros(1, 2, 2)).tolist() == [[[0.25, 0.25], [0.25, 0.25]]]


def test_a_file_does_not_shadow_a_module(file: Path) -> None:
    named = file.with_name("json.py")
    named.write_text(CODE)
    assert origin_of_explainer(find_explainer(f"{named}:half")).entry_point == "json.py:half"
    assert sys.modules["json"] is json


@pytest.mark.parametrize(
    ("reference", "said"),
    [
        ("{folder}/missing.py:x", "cannot be read"),
        ("{folder}/own.py:nothing", "has no 'nothing': give one of nearest, Scaled"),
        ("{folder}/empty.py:x", "has no 'x': it defines no names"),
        ("{folder}/own.py:", "is not a reference to an object"),
        (":x", "is not a reference to an object"),
        ("no_such_module:x", "ModuleNotFoundError"),
        ("{folder}/broken.py:x", r"failed to load \(ZeroDivisionError"),
        ("{folder}/stops.py:x", r"failed to load \(SystemExit"),
        ("math:pi", "a float is not an explainer"),
        ("math:sqrt", "name its parameters"),
    ],
)
def test_a_failure_to_load_is_one_sentence(reference: str, said: str, file: Path) -> None:
    (file.parent / "empty.py").touch()
    (file.parent / "broken.py").write_text("1 / 0\n")
    (file.parent / "stops.py").write_text("raise SystemExit(3)\n")
    with pytest.raises(InputError, match=said) as raised:
        find_explainer(reference.format(folder=file.parent))
    assert "\n" not in str(raised.value)


@pytest.mark.slow
def test_a_file_is_scored_and_recorded(
    run_cli: RunCli, make_bundle: MakeBundle, file: Path, tmp_path: Path
) -> None:
    ran = run_cli(
        "score", "--policy", make_bundle(), "--explainer", f"{file}:nearest", "--explainer", f"{file}:half",
        *QUICK, "--out", tmp_path / "board",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    entries = {entry.explainer.name: entry.explainer for _, entry in read_entries(tmp_path / "board/entries")}
    assert {name: each.entry_point for name, each in entries.items()} == {
        "nearest": "own.py:nearest",
        "scaled": "own.py:half",
    }
    assert entries["scaled"].code_sha256 == hashlib.sha256(CODE.encode()).hexdigest()
    assert entries["scaled"].accesses == "black-box"


def test_a_function_that_exec_made_has_an_origin() -> None:
    scope: dict[str, Any] = {"torch": torch}
    exec("def made(observations):\n    return torch.ones(len(observations), 3, 3)", scope)
    assert scope["made"].__module__ is None
    assert origin_of_explainer(as_explainer(scope["made"])).entry_point == "__main__:made"
