"""What explainers declare, read from their source: listing them runs no code of any package.

Understands what docs/explainers.md shows: `name = Explainer(...)`, `messages_only(other)` of the same file,
functions and classes, `as_explainer(...)` of these as call and as decorator. What is computed, imported from
another module or inherited is not known.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib.machinery import PathFinder
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from xmarl_bench.explain.control_names import BY_ZERO, STOCHASTIC, SUMMARIES
from xmarl_bench.origin.installed import package_version
from xmarl_bench.origin.references import definitions
from xmarl_bench.plugins.names import explainer_plugins

POSITIONAL = ("name", "explain", "summary")  # the first parameters of Explainer
DEFAULTS = {"stochastic": False, "slow": False, "absence": None, "summary": ""}


@dataclass(frozen=True)
class Declared:
    """An explainer of a list; None: not known without running its code."""

    name: str
    kind: str  # "control" or "explainer"
    stochastic: bool | None
    slow: bool | None
    absence: str | None
    distribution: str | None
    version: str | None
    summary: str | None


def declared_explainers() -> list[Declared]:
    """Controls first, then the explainers of installed packages by name."""
    harness = package_version("xmarl-bench")
    controls = [
        Declared(
            name,
            "control",
            name in STOCHASTIC,
            False,
            "zero" if name in BY_ZERO else None,
            "xmarl-bench",
            harness,
            summary,
        )
        for name, summary in SUMMARIES.items()
    ]
    return controls + [_of_plugin(plugin) for plugin in explainer_plugins().values()]


def _of_plugin(plugin: EntryPoint) -> Declared:
    name, version = (None, None) if plugin.dist is None else (plugin.dist.name, plugin.dist.version)
    unknown = Declared(plugin.name, "explainer", None, None, None, name, version, None)
    source = source_of(plugin.module)
    if source is None:
        return unknown
    try:
        body = ast.parse(source.read_bytes()).body
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return unknown
    found = declarations(body, plugin.attr)
    return unknown if found is None else replace(unknown, **found)


def source_of(module: str) -> Path | None:
    """The file of an importable module, found as the import system finds it, without importing anything."""
    where: list[str] | None = None
    spec = None
    for part in module.split("."):
        spec = PathFinder.find_spec(part, where)
        if spec is None:
            return None
        where = list(spec.submodule_search_locations or ())
    return None if spec is None or not spec.has_location or spec.origin is None else Path(spec.origin)


def declarations(body: Iterable[ast.stmt], name: str) -> dict[str, Any] | None:
    """What the object `name` of a module declares; None if the module does not show it."""
    defined = definitions(body)
    return _declared(defined.get(name), defined)


def _declared(thing: ast.AST | None, defined: dict[str, ast.AST]) -> dict[str, Any] | None:
    if isinstance(thing, ast.Name):
        return _declared(defined.get(thing.id), defined)
    if isinstance(thing, ast.FunctionDef | ast.ClassDef):
        own = {"summary": (ast.get_docstring(thing) or "").partition("\n")[0]}
        if isinstance(thing, ast.ClassDef):
            own |= _values(definitions(thing.body).items())
        calls = [each for each in thing.decorator_list if isinstance(each, ast.Call)]
        return DEFAULTS | own | {key: value for each in calls for key, value in _keywords(each).items()}
    if not isinstance(thing, ast.Call):
        return None
    called = thing.func.id if isinstance(thing.func, ast.Name) else ""
    if called == "Explainer":
        return DEFAULTS | _values(zip(POSITIONAL, thing.args, strict=False)) | _keywords(thing)
    if called in ("as_explainer", "messages_only") and thing.args:
        inner = _declared(thing.args[0], defined)
        if inner is None or called == "as_explainer":
            return None if inner is None else inner | _keywords(thing)
        return inner | {"summary": f"{inner['summary']}; an agent always hears itself"}
    return _declared(defined.get(called), defined)  # Class(...)


def _keywords(call: ast.Call) -> dict[str, Any]:
    return _values((each.arg, each.value) for each in call.keywords)


def _values(pairs: Iterable[tuple[str | None, ast.AST]]) -> dict[str, Any]:
    """Literals, and members of Absence; None for what is computed."""
    values: dict[str, Any] = {}
    for key, value in pairs:
        if key in DEFAULTS:
            if isinstance(value, ast.Attribute):
                values[key] = value.attr.lower()
            else:
                values[key] = value.value if isinstance(value, ast.Constant) else None
    return values
