"""Finds policies and explainers by name, among those of every installed package.

Explainers: entry points in group `xmarl_bench.explainers`, name -> an `Explainer` of the same name.
Policies: entry points in group `xmarl_bench.policies`, each -> a function without arguments that returns
{policy name: folder of its bundle}. A plugin that fails to load raises, with its name.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from xmarl_envs import TASKS

from xmarl_bench.controls import CONTROLS
from xmarl_bench.errors import InputError
from xmarl_bench.explainer import Explainer
from xmarl_bench.policy.bundle import CARD
from xmarl_bench.provenance import package_version

EXPLAINERS, POLICIES = "xmarl_bench.explainers", "xmarl_bench.policies"
NAME = re.compile(r"^[a-z0-9][a-z0-9._-]{0,99}$")  # safe in file names


@dataclass(frozen=True)
class FoundExplainer:
    """An explainer and where it came from."""

    explainer: Explainer
    distribution: str | None
    version: str | None
    entry_point: str


def as_found(explainer: Explainer) -> FoundExplainer:
    """An explainer handed over as an object, that no package registers."""
    if not NAME.match(explainer.name):
        raise InputError(
            f"explainer name {explainer.name!r} cannot be part of a file name: use a-z, 0-9, . _ and -."
        )
    explain = explainer.explain
    where = explain if hasattr(explain, "__qualname__") else type(explain)
    return FoundExplainer(explainer, None, None, f"{where.__module__}:{where.__qualname__}")


def explainer_names() -> list[str]:
    """Controls first, then plugins by name; nothing is loaded."""
    return [*CONTROLS, *sorted(_explainer_plugins())]


def find_explainer(name: str) -> FoundExplainer:
    """Load one explainer. Raises InputError for an unknown name or a plugin that does not load."""
    if name in CONTROLS:
        return FoundExplainer(
            CONTROLS[name],
            "xmarl-bench",
            package_version("xmarl-bench"),
            f"xmarl_bench.controls:CONTROLS[{name!r}]",
        )
    plugins = _explainer_plugins()
    if name not in plugins:
        raise unknown("explainer", name, explainer_names())
    plugin = plugins[name]
    explainer = _load(plugin)
    if not isinstance(explainer, Explainer):
        raise InputError(
            f"explainer plugin {name!r} ({plugin.value}) is a {type(explainer).__name__}: "
            f"let its entry point name an xmarl_bench Explainer."
        )
    if explainer.name != name:
        raise InputError(
            f"explainer plugin {name!r} ({plugin.value}) calls itself {explainer.name!r}: "
            f"use one name for both."
        )
    as_found(explainer)  # a name that is fit for files
    return FoundExplainer(explainer, *_distribution(plugin), plugin.value)


def find_policies() -> dict[str, Path]:
    """Every registered policy: name -> folder of its bundle, by name."""
    found: dict[str, Path] = {}
    for plugin in entry_points(group=POLICIES):
        listed = _load(plugin)
        try:
            folders = {str(name): Path(folder) for name, folder in listed().items()}
        except Exception as error:
            raise _plugin_error(plugin, error) from error
        for name, folder in folders.items():
            if name in found:
                raise InputError(
                    f"policy {name!r} is registered twice ({found[name]} and {folder}): rename one."
                )
            found[name] = folder
    return dict(sorted(found.items()))


def find_policy(name_or_folder: str) -> Path:
    """The bundle's folder. What holds a bundle or has a path separator is a folder, anything else a name."""
    folder = Path(name_or_folder)
    if (folder / CARD).is_file() or len(folder.parts) > 1:
        return folder
    policies = find_policies()
    if name_or_folder not in policies:
        raise unknown("policy", name_or_folder, policies, "or give the folder of a policy bundle")
    return policies[name_or_folder]


def check_task(name: str) -> None:
    if name not in TASKS:
        raise unknown("task", name, TASKS)


def unknown(kind: str, name: str, choices: Iterable[str], hint: str = "") -> InputError:
    """The error for a name that is none of the choices, with the nearest one if there is one."""
    listed = list(choices)
    near = difflib.get_close_matches(name, listed, n=1)
    guess = f" Did you mean {near[0]!r}?" if near else ""
    others = f"choose one of {', '.join(listed)}" if listed else "none is installed"
    return InputError(f"unknown {kind} {name!r}: {others}{', ' + hint if hint else ''}.{guess}")


def _explainer_plugins() -> dict[str, EntryPoint]:
    plugins: dict[str, EntryPoint] = {}
    for plugin in entry_points(group=EXPLAINERS):
        if plugin.name in CONTROLS or plugin.name in plugins:
            other = plugins[plugin.name].value if plugin.name in plugins else "a control of xmarl-bench"
            raise InputError(
                f"explainer {plugin.name!r} ({plugin.value}) has the name of {other}: rename one."
            )
        plugins[plugin.name] = plugin
    return plugins


def _load(plugin: EntryPoint) -> Any:
    try:
        return plugin.load()
    except Exception as error:
        raise _plugin_error(plugin, error) from error


def _plugin_error(plugin: EntryPoint, error: Exception) -> InputError:
    name, _ = _distribution(plugin)
    return InputError(
        f"plugin {plugin.name!r} ({plugin.value}, of {name or 'an unknown distribution'}) failed to load "
        f"({type(error).__name__}: {error}): correct or uninstall it."
    )


def _distribution(plugin: EntryPoint) -> tuple[str | None, str | None]:
    return (plugin.dist.name, plugin.dist.version) if plugin.dist is not None else (None, None)
