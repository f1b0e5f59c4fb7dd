"""Policies given as code: accepted if trusted, refused otherwise, and recorded in the entry."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import TransformerConv

from tests.bench.checks.test_policy_checks import Pilot
from tests.conftest import MakeBundle, RunCli
from xmarl_bench import PolicyModule, RadiusGraph, score
from xmarl_bench.entry.file import read_entries
from xmarl_bench.errors import InputError
from xmarl_bench.plugins import names, registry
from xmarl_bench.policy import CodeArchitecture

RAN: list[str] = []
HERE = "tests.bench.policy.test_code"
QUICK = ("--episodes", 1, "--timesteps", 3, "--max-cycles", 4, "--behaviour-episodes", 0)


def pilot() -> PolicyModule:
    RAN.append("pilot")
    return PolicyModule("pilot", Pilot(), "blind_navigation_v0", 3)


def near() -> PolicyModule:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = TransformerConv(6, 4, heads=2, concat=False)
    return PolicyModule("near", network, "blind_navigation_v0", 4, graph=RadiusGraph(radius=1.0))


def crashes() -> PolicyModule:
    raise RuntimeError("no weights here")


def leaves() -> PolicyModule:
    raise SystemExit(4)


def no_network() -> PolicyModule:
    return PolicyModule("none", "weights", "blind_navigation_v0", 3)  # type: ignore[arg-type]


def no_task() -> PolicyModule:
    return PolicyModule("none", Pilot(), ["blind_navigation_v0"], 3)  # type: ignore[arg-type]


def wordy() -> PolicyModule:
    raise RuntimeError("first line\nsecond line")


def nothing() -> None:
    return None


def nowhere() -> PolicyModule:
    return PolicyModule("nowhere", Pilot(), "chess", 3)


def misnamed() -> PolicyModule:
    return PolicyModule("Not A Name", Pilot(), "blind_navigation_v0", 3)


class Dense(nn.Module):
    """Agents interact in a sum over all rows."""

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        return (x - x.mean(dim=0))[:, :4]


def dense() -> PolicyModule:
    return PolicyModule("dense", Dense(), "blind_navigation_v0", 3)


def listed() -> dict[str, object]:
    return {"pilot": pilot, "other": near}


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("mine", f"{HERE}:listed", names.POLICIES)
    monkeypatch.setattr(names, "entry_points", lambda group: [point] if group == names.POLICIES else [])


@pytest.mark.usefixtures("plugin")
def test_code_does_not_run_unless_trusted(run_cli: RunCli, tmp_path: Path) -> None:
    RAN.clear()
    for name in ("pilot", f"{HERE}:pilot"):
        ran = run_cli("score", "--policy", name, "--explainer", "self", *QUICK, "--out", tmp_path)
        assert ran.code == 2
        assert "--trust-code" in ran.err
    assert {row["name"]: row["code"] for row in json.loads(run_cli("list", "policies", "--json").out)} == {
        "other": f"{HERE}:listed",
        "pilot": f"{HERE}:listed",
    }
    assert RAN == []


@pytest.mark.slow
@pytest.mark.usefixtures("plugin")
@pytest.mark.parametrize("name", ["pilot", f"{HERE}:pilot"])
def test_trusted_code_is_scored_and_the_entry_records_it(name: str, run_cli: RunCli, tmp_path: Path) -> None:
    ran = run_cli("score", "--policy", name, "--explainer", "self", *QUICK, "--out", tmp_path, "--trust-code")
    assert ran.code == 0, ran.err
    ((_, entry),) = read_entries(tmp_path / "entries")
    assert entry.policy.trusted_code
    architecture = entry.policy.architecture
    assert isinstance(architecture, CodeArchitecture)
    assert architecture.entry_point == f"{HERE}:pilot"
    assert entry.results[0].metrics.fid_plus.value


@pytest.mark.slow
def test_a_module_from_a_notebook_is_scored_directly() -> None:
    entry = score(near(), "random", episodes=1, timesteps=3, max_cycles=4, behaviour_episodes=0)
    assert entry.policy.trusted_code
    assert entry.policy.architecture.graph == RadiusGraph(radius=1.0)
    assert entry.results[0].n_agents == 4
    assert (
        entry.policy.weights_sha256 == registry.open_policy(f"{HERE}:near", trust_code=True)[1].weights_sha256
    )


@pytest.mark.parametrize(
    ("factory", "said"),
    [
        ("crashes", "RuntimeError: no weights here"),
        ("nothing", "NoneType: make its factory return a PolicyModule"),
        ("nowhere", "unknown task 'chess'"),
        ("misnamed", "no valid name"),
        ("leaves", r"could not be made \(SystemExit: 4\)"),
        ("no_network", "the network of policy 'none' is a str"),
        ("no_task", r"has task \['blind_navigation_v0'\]: give a name or a function"),
        ("RAN", "is a list"),
        ("gone", "has no 'gone'"),
    ],
)
def test_factories_that_return_no_policy_are_refused(factory: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        registry.open_policy(f"{HERE}:{factory}", trust_code=True)


def test_an_error_of_several_lines_is_printed_on_one(run_cli: RunCli) -> None:
    ran = run_cli("check", "policy", f"{HERE}:wordy", "--trust-code")
    assert (ran.code, ran.out) == (2, "")
    assert "(RuntimeError: first line second line)" in ran.err
    assert len(ran.err.splitlines()) == 1


@pytest.mark.usefixtures("plugin")
def test_a_plugin_s_policy_must_have_its_registered_name() -> None:
    with pytest.raises(InputError, match=r"'other'.*calls itself 'near'"):
        registry.open_policy("other", trust_code=True)
    with pytest.raises(InputError, match="has no bundle"):
        names.find_policy("pilot")


def test_a_bundle_does_not_need_trust(make_bundle: MakeBundle) -> None:
    policy, card = registry.open_policy(str(make_bundle()))
    assert card.name == "small"
    assert not policy.training


@pytest.mark.slow
@pytest.mark.parametrize("command", ["check policy", "score --explainer self --policy"])
def test_a_network_that_masks_cannot_reach_is_refused_before_anything_runs(
    command: str, run_cli: RunCli, tmp_path: Path
) -> None:
    where = ("--out", tmp_path) if "score" in command else ()
    ran = run_cli(*command.split(), f"{HERE}:dense", "--trust-code", *where)
    assert ran.code == 2
    assert "Dense passes no message through a layer of torch_geometric" in ran.err


def test_a_factory_in_a_file_is_loaded(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "from tests.bench.checks.test_policy_checks import Pilot\n"
        "from xmarl_bench import PolicyModule\n"
        "def make():\n"
        "    return PolicyModule('filed', Pilot(), 'blind_navigation_v0', 3)\n"
    )
    _, card = registry.open_policy(f"{file}:make", trust_code=True)
    assert isinstance(card.architecture, CodeArchitecture)
    assert card.architecture.entry_point == "mine.py:make"
    assert card.architecture.code_sha256 is not None
