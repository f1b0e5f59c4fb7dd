"""What a list reads from an explainer's source is what the explainer declares when it runs."""

from __future__ import annotations

import ast
import sys
from dataclasses import asdict
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from tests.helpers.shipped import shipped_plugins
from xmarl_bench.explain.adapters import as_explainer
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.plugins import names
from xmarl_bench.plugins.declarations import declarations, declared_explainers, source_of

FIELDS = ("stochastic", "slow", "absence", "summary")
SOURCE = '''
from xmarl_bench import as_explainer, Explainer
from elsewhere import imported

def plain(observations):
    """One line.

    More."""

@as_explainer(stochastic=True, absence="mean")
def decorated(observations):
    """Shaken."""

class Typical:
    """How unlike."""
    slow = True
    stochastic = len("x") == 1

    def __init__(self, power=1.0):
        self.power = power

    def explain(self, observations):
        return observations

made = as_explainer(Typical(2.0), summary="made")
typed: Explainer = Explainer("typed", plain, "typed", slow=True)
'''


def test_shipped_explainers_and_controls_are_listed_as_they_declare(monkeypatch: pytest.MonkeyPatch) -> None:
    plugins = shipped_plugins()
    monkeypatch.setattr(names, "entry_points", lambda group: plugins)
    explainers = {**CONTROLS, **{plugin.name: plugin.load() for plugin in plugins}}
    listed = declared_explainers()
    assert [each.name for each in listed] == list(explainers)
    for each in listed:
        explainer = explainers[each.name]
        assert each.kind == ("control" if explainer.control else "explainer")
        for field in FIELDS:
            assert getattr(each, field) == getattr(explainer, field), (each.name, field)


@pytest.mark.parametrize("name", ["plain", "decorated", "made", "typed"])
def test_every_form_is_read_as_it_runs(name: str) -> None:
    source = SOURCE.replace("from elsewhere import imported", "")
    run: dict[str, object] = {}
    exec(source, run)
    explainer = as_explainer(run[name])
    found = declarations(ast.parse(source).body, name)
    assert found is not None
    # Typical computes `stochastic`, so only running it tells.
    expected = {field: getattr(explainer, field) for field in FIELDS}
    assert found == (expected | {"stochastic": None} if name == "made" else expected)


def test_what_the_source_does_not_show_is_unknown() -> None:
    body = ast.parse(SOURCE).body
    assert declarations(body, "imported") is None
    assert declarations(body, "missing") is None


def test_listing_imports_no_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "strange_package"
    package.mkdir()
    (package / "__init__.py").write_text("raise SystemExit('ran')\n")
    (package / "own.py").write_text('def own(observations):\n    """Mine."""\nraise SystemExit("ran")\n')
    monkeypatch.syspath_prepend(tmp_path)
    points = [
        EntryPoint("own", "strange_package.own:own", names.EXPLAINERS),
        EntryPoint("gone", "strange_package.gone:gone", names.EXPLAINERS),
    ]
    monkeypatch.setattr(names, "entry_points", lambda group: points)
    gone, own = declared_explainers()[-2:]
    assert (own.summary, own.slow) == ("Mine.", False)
    assert {gone.summary, *(asdict(gone)[field] for field in FIELDS)} == {None}
    assert "strange_package" not in sys.modules
    assert source_of("strange_package") == package / "__init__.py"
