"""Names resolve through entry points, and a plugin that fails to load is reported."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from xmarl_baselines.explainers.attention import attention
from xmarl_baselines.explainers.shapley import shapley_messages

from tests.conftest import MakeBundle, RunCli
from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import origin_of_explainer
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.origin.plugins import load_plugin
from xmarl_bench.plugins import names, registry
from xmarl_bench.tasks.parallel_task import foreign_code


def install(monkeypatch: pytest.MonkeyPatch, **plugins: str) -> None:
    """Pretend that a package registered these explainers: name (with _ for -) = "module:object"."""
    points = [EntryPoint(name.replace("_", "-"), value, names.EXPLAINERS) for name, value in plugins.items()]
    monkeypatch.setattr(names, "entry_points", lambda group, **_: points if group == names.EXPLAINERS else [])


def test_shipped_explainers_are_found_by_their_names() -> None:
    listed = names.explainer_names()
    assert listed[: len(CONTROLS)] == list(CONTROLS)
    assert {"attention", "gnn_explainer", "graphmask-pyg"} <= set(listed)
    found = registry.find_explainer("attention")
    assert (origin_of_explainer(found).distribution, found.control) == ("xmarl-bench", False)
    assert registry.find_explainer("random").control


def test_a_plugin_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, vandal="tests.helpers.example_plugins:vandal")
    origin = origin_of_explainer(registry.find_explainer("vandal"))
    assert origin.entry_point == "tests.helpers.example_plugins:vandal"


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("gone", "tests.bench.no_such_module:x", "ModuleNotFoundError"),
        ("gone", "tests.helpers.example_plugins:no_such_name", "AttributeError"),
        ("gone", "tests.helpers.example_plugins:not_an_explainer", "a str is not an explainer"),
        ("gone", "tests.helpers.example_plugins:misnamed", "'another'"),
        ("random", "tests.helpers.example_plugins:vandal", "control"),
    ],
)
def test_the_error_of_a_plugin_that_fails_to_load_names_it(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, said: str
) -> None:
    install(monkeypatch, **{name: value})
    with pytest.raises(InputError, match=f"'{name}'.*{said}"):
        for each in names.explainer_names():
            registry.find_explainer(each)


def test_a_broken_plugin_does_not_affect_others(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, broken="tests.bench.no_such_module:x", vandal="tests.helpers.example_plugins:vandal")
    assert registry.find_explainer("vandal").name == "vandal"


def test_an_unknown_name_lists_the_choices_and_the_nearest() -> None:
    with pytest.raises(InputError, match=r"'atention'.*did you mean 'attention'\?.*all-ones.*gnn_explainer"):
        registry.find_explainer("atention")


def test_policies_come_from_plugins_or_folders(
    monkeypatch: pytest.MonkeyPatch, make_bundle: MakeBundle
) -> None:
    folder = make_bundle(name="mine")
    point = EntryPoint("x", "tests.bench.plugins.test_registry:shipped", names.POLICIES)
    monkeypatch.setattr(names, "entry_points", lambda group: [point])
    monkeypatch.setitem(SHIPPED, "mine", folder)
    assert names.find_policies() == {"mine": folder}
    assert names.find_policy("mine") == names.find_policy(str(folder)) == folder
    with pytest.raises(InputError, match=r"'yours'.*mine.*folder"):
        names.find_policy("yours")


def test_a_policy_plugin_that_fails_to_load_does_not_hide_others(
    monkeypatch: pytest.MonkeyPatch, make_bundle: MakeBundle, run_cli: RunCli
) -> None:
    folder = make_bundle(name="mine")
    monkeypatch.setitem(SHIPPED, "mine", folder)
    points = [
        EntryPoint("broken", "tests.bench.no_such_module:x", names.POLICIES),
        EntryPoint("x", "tests.bench.plugins.test_registry:shipped", names.POLICIES),
    ]
    monkeypatch.setattr(names, "entry_points", lambda group: points)
    listed = run_cli("list", "policies")
    assert listed.code == 2
    assert "mine" in listed.out
    assert "'broken'" in listed.err
    assert "ModuleNotFoundError" in listed.err
    assert registry.open_policy("mine")[1].name == "mine"
    for look in (names.find_policies, lambda: registry.open_policy("yours")):
        with pytest.raises(InputError, match="'broken'"):
            look()


SHIPPED: dict[str, Path] = {}


def shipped() -> dict[str, Path]:
    return SHIPPED


def test_a_plugin_that_exits_when_it_is_imported_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "plugin_that_exits.py").write_text("raise SystemExit(3)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"'leaver' .* failed to load \(SystemExit: 3\)"):
        load_plugin(EntryPoint("leaver", "plugin_that_exits:make", names.EXPLAINERS))


def test_a_task_that_exits_is_named() -> None:
    said = r"'mine' failed in step \(SystemExit: 3\)"
    with pytest.raises(InputError, match=said), foreign_code("mine", "step"):
        raise SystemExit(3)


def test_a_shipped_explainer_passed_as_an_object_has_the_origin_of_its_name() -> None:
    for explainer in (attention, shapley_messages):
        assert registry.recorded_origin(explainer) == registry.find_explainer(explainer.name).origin
    own = replace(attention, hyperparameters={"mine": 1})
    assert registry.recorded_origin(own).entry_point == "xmarl_baselines.explainers.attention:attention_mask"
