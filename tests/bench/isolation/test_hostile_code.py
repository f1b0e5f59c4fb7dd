"""Hostile explainers and policies in a run: their own failure, and everybody else's entries to the bit."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.conftest import MakeBundle, RunCli
from xmarl_bench import as_explainer, score
from xmarl_bench.entry.file import read_entries
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.isolation.conversation import end_strangers
from xmarl_bench.plugins import names
from xmarl_bench.plugins.names import POLICIES, registered_policies
from xmarl_bench.plugins.registry import ask_explainer, isolated
from xmarl_bench.policy import Policy

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="needs processes of Unix")]
QUICK = ("--episodes", 3, "--timesteps", 3, "--max-cycles", 6, "--behaviour-episodes", 1)

# Breaks what it can reach when it is imported.
VANDAL = """
import os, sys

import numpy as np
import torch

import xmarl_bench.metrics as metrics
import xmarl_bench.metrics.budgeted_fidelity as budgeted
from xmarl_bench.scoring.states import States

torch.set_default_dtype(torch.float64)
torch.set_num_threads(7)
np.random.seed(0)
for module in (metrics, budgeted):
    for name in list(vars(module)):
        if callable(getattr(module, name)) and name.islower():
            setattr(module, name, lambda *_, **__: 1.0)
States.with_inverse = States.mask_metrics = lambda *_: 1 / 0
torch.Tensor.abs = torch.Tensor.mean = lambda self, *_, **__: torch.ones(())
os.chdir("/")
os.environ.clear()
print("noise")
sys.stderr.write("noise")

def vandal(observations):
    return torch.ones(len(observations), observations.shape[1], observations.shape[1])

def crashes(observations):
    os._exit(7)
"""
# Explains by the harness's table of the oracle, if it finds it in a frame or anywhere in memory.
THIEF = """
import gc, sys

import torch

from xmarl_bench.scoring.states import States

def thief(observations):
    held, frame = list(gc.get_objects()), sys._getframe()
    while frame is not None:
        held += frame.f_locals.values()
        frame = frame.f_back
    stolen = [each.oracle_mask for each in held if isinstance(each, States)]
    return stolen[0] if stolen else torch.ones(len(observations), *[observations.shape[1]] * 2)
"""


@pytest.fixture(autouse=True)
def end() -> Iterator[None]:
    yield
    end_strangers()


def test_hostile_code_in_a_sweep_changes_no_other_entry(
    make_bundle: MakeBundle, tmp_path: Path, run_cli: RunCli
) -> None:
    bundle = make_bundle()
    for name, code in {"vandal": VANDAL, "thief": THIEF}.items():
        (tmp_path / f"{name}.py").write_text(code)
    hostile = ("vandal.py:vandal", "vandal.py:crashes", "thief.py:thief")
    options = [part for each in hostile for part in ("--explainer", tmp_path / each)]

    def scored(*more: object) -> tuple[dict[str, Entry], int, str]:
        folder = tmp_path / f"out{len(more)}"
        ran = run_cli(
            "score", "--policy", bundle, *more, "--explainer", "occlusion", *QUICK, "--out", folder,
            "--cache", tmp_path / f"cache{len(more)}",
        )  # fmt: skip
        return {each.explainer.name: each for _, each in read_entries(folder / "entries")}, ran.code, ran.err

    alone, code_alone, _ = scored()
    beside, code_beside, errors = scored(*options)
    assert (code_alone, code_beside) == (0, 1)
    assert alone["occlusion"].entry_id == beside["occlusion"].entry_id
    assert beside.keys() - {"vandal"} == {"occlusion", "thief"}
    said = r"failed: crashes on small: the process of explainer vandal.py:crashes ended \(exit code 7\)"
    assert re.search(said, errors), errors
    assert "noise" not in errors
    (cell,) = beside["thief"].results
    for name, mean in cell.controls["all-ones"].model_dump().items():  # it found no oracle
        if mean is not None and mean["value"] is not None:
            assert getattr(cell.metrics, name).value == pytest.approx(mean["value"], rel=1e-6, abs=1e-6), name
    assert beside["thief"].explainer.isolated is None


def closing_over(number: float) -> Callable[[Policy, Tensor], Tensor]:
    class Local:
        """A class that no other process can import."""

        def __init__(self) -> None:
            self.number = number

    local = Local()

    def own(policy: Policy, observations: Tensor) -> Tensor:
        return policy.attention(observations).detach() ** local.number

    return own


def test_functions_of_a_notebook_run_in_a_process_of_their_own(
    make_bundle: MakeBundle, tmp_path: Path
) -> None:
    bundle, own = make_bundle(), closing_over(2.0)
    quick = {"episodes": 2, "timesteps": 2, "max_cycles": 5, "behaviour_episodes": 1}
    apart = score(bundle, own, **quick)  # type: ignore[arg-type]
    here = score(bundle, own, isolate=False, cache=tmp_path / "cache", **quick)  # type: ignore[arg-type]
    assert apart.results == here.results
    assert (apart.explainer.isolated, here.explainer.isolated) == (None, False)
    assert apart.explainer.code_sha256 == here.explainer.code_sha256
    assert not (tmp_path / "cache").exists()  # nothing of that process is kept
    assert score(bundle, "attention", isolate=False, **quick).explainer.isolated is None  # type: ignore[arg-type]


def test_fitted_explainers_give_the_same_entry_on_any_number_of_workers(
    make_bundle: MakeBundle, tmp_path: Path
) -> None:
    code = tmp_path / "learns.py"
    code.write_text(LEARNS)
    bundle = make_bundle()
    ids = [
        score(
            bundle, f"{code}:learns", jobs=jobs, episodes=12, timesteps=2, max_cycles=4, behaviour_episodes=0
        ).entry_id
        for jobs in (1, 2)
    ]
    assert ids[0] == ids[1]


@pytest.mark.parametrize("reference", ["snippet.py:half", "snippet:half"])
def test_code_that_scores_while_it_is_loaded_is_refused(
    reference: str, make_bundle: MakeBundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would start processes without end."""
    bundle = make_bundle()
    (tmp_path / "snippet.py").write_text(
        "import torch\nfrom xmarl_bench import score\n\n"
        "def half(observations):\n    return torch.full((len(observations), 3, 3), 0.5)\n\n"
        f"score({str(bundle)!r}, half, episodes=1, max_cycles=2, behaviour_episodes=0)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r'scores while it is loaded: put .* under `if __name__ == "__main'):
        score(bundle, reference, episodes=1, max_cycles=2, behaviour_episodes=0)


LEARNS = """
import torch

class learns:
    needs_fit, stochastic = True, True

    def fit(self, observations, policy, generator):
        self.mean = policy.attention(observations).detach().mean(0) + torch.rand((), generator=generator)

    def explain(self, observations):
        return self.mean.expand(len(observations), -1, -1) / 2
"""


def test_what_cannot_be_sent_is_refused_in_one_sentence() -> None:
    def locked(observations: Tensor, lock: object = os.scandir(".")) -> Tensor:
        return torch.ones(1)

    explainer = as_explainer(locked)
    assert isinstance(explainer, Explainer)
    with pytest.raises(InputError, match=r"'locked' cannot be sent to a process of its own \(TypeError"):
        isolated(explainer)


PLUGIN = """
from pathlib import Path

Path(__file__).with_name("imported").touch()
def policies():
    return {"foreign": Path(__file__).with_name("bundle"), "made": lambda: None}

def foreign(observations):
    "Explains."
    return observations.new_ones(len(observations), 3, 3)
"""


def test_packages_of_others_are_not_imported_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither to list their policies, nor to load their explainers and to find out where they come from."""
    (tmp_path / "strange_package.py").write_text(PLUGIN)
    about = tmp_path / "strange_package-0.3.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: strange-package\nVersion: 0.3\n")
    (about / "entry_points.txt").write_text(
        "[xmarl_bench.policies]\nstrange = strange_package:policies\n"
        "[xmarl_bench.explainers]\nforeign = strange_package:foreign\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    (plugin,) = (each for each in entry_points(group=POLICIES) if each.name == "strange")
    assert plugin.value == "strange_package:policies"
    found, failures = registered_policies()
    assert failures == []
    assert found["foreign"] == tmp_path / "bundle"
    assert found["made"] == plugin
    with monkeypatch.context() as patch:
        patch.setattr(names, "Stranger", lambda *_: pytest.fail("a package is asked once"))
        assert registered_policies() == (found, failures)
    explainer = ask_explainer("foreign")
    assert explainer.origin is not None
    assert (explainer.origin.distribution, explainer.origin.version) == ("strange-package", "0.3")
    assert explainer.summary == "Explains."
    assert (tmp_path / "imported").exists()
    assert "strange_package" not in sys.modules
