"""Loads policies and explainers by the names that xmarl_bench.plugins.names lists, or by reference to code.

`ask_explainer` loads explainers that are not shipped in a process of their own. A plugin that fails to load
raises an error with its name.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import as_explainer, origin_of_explainer
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.isolation.conversation import PLAIN, Isolation, Source
from xmarl_bench.isolation.explainers import find_elsewhere, isolate
from xmarl_bench.isolation.policies import open_elsewhere
from xmarl_bench.origin.installed import package_version
from xmarl_bench.origin.plugins import load_plugin, origin_of_plugin
from xmarl_bench.origin.references import (
    Origin,
    check_named,
    is_reference,
    load_reference,
    located,
)
from xmarl_bench.plugins.code_policies import run_policy
from xmarl_bench.plugins.names import explainer_plugin, is_shipped, place_of
from xmarl_bench.policy import Policy, PolicyCard, load_policy
from xmarl_bench.policy.device import CPU
from xmarl_bench.records.field_types import is_file_name


def find_explainer(name: str) -> Explainer:
    """An explainer with its origin, by its name or by `path/to/file.py:Name` or `module:Name`. Runs its code.

    Raises InputError for an unknown name, and for a plugin or a file that does not load.
    """
    check_named(name)
    what = f"explainer {name!r}"
    if name in CONTROLS:
        where = f"xmarl_bench.explain.controls:CONTROLS[{name!r}]"
        thing, origin = CONTROLS[name], Origin("xmarl-bench", package_version("xmarl-bench"), where)
    elif is_reference(name):
        thing, origin = load_reference(name)
    else:
        plugin = explainer_plugin(name)
        what = f"explainer plugin {name!r} ({plugin.value})"
        thing, origin = load_plugin(plugin), origin_of_plugin(plugin)
    try:
        explainer = as_explainer(thing)
    except InputError as error:
        raise InputError(f"{what} cannot be used: {error}") from None
    if not is_reference(name):
        if not isinstance(thing, Explainer):  # it has no name of its own
            explainer = replace(explainer, name=name)
        if explainer.name != name:
            raise InputError(f"{what} calls itself {explainer.name!r}: use one name for both.")
    return checked_name(replace(explainer, origin=origin))


def ask_explainer(name: str, isolation: Isolation | None = PLAIN) -> Explainer:
    """As `find_explainer`, but one that is not shipped is loaded and asked in a process of its own.

    isolation: None: in this process. Raises InputError as `find_explainer` does, and if the process fails.
    """
    check_named(name)
    if isolation is None or is_shipped(name):
        return find_explainer(name)
    if is_reference(name):
        name, readable, origin = located(name)
    else:
        readable, origin = (), origin_of_plugin(explainer_plugin(name))
    found = find_elsewhere(name, origin, readable, isolation)
    if not is_reference(name) and found.name != name:
        raise InputError(f"explainer plugin {name!r} calls itself {found.name!r}: use one name for both.")
    return checked_name(found)


def isolated(explainer: Explainer, isolation: Isolation | None = PLAIN) -> Explainer:
    """An explainer made in Python, asked in a process of its own unless it is a shipped one.

    isolation: None: in this process.
    """
    if isolation is None or explainer.elsewhere is not None or is_shipped_code(explainer):
        return explainer
    return isolate(explainer, isolation)


def is_shipped_code(explainer: Explainer) -> bool:
    """Whether the explainer is the shipped one of its name."""
    anywhere = replace(explainer, device=CPU)
    return is_shipped(explainer.name) and find_explainer(explainer.name) == anywhere


def recorded_origin(explainer: Explainer) -> Origin:
    """The origin in an entry: of a shipped explainer that is passed as an object, that of its name."""
    return origin_of_explainer(find_explainer(explainer.name) if is_shipped_code(explainer) else explainer)


def checked_name(explainer: Explainer) -> Explainer:
    """The explainer. Raises InputError if its name is unsafe in file names or that of a control."""
    name = explainer.name
    if not is_file_name(name):
        raise InputError(f"explainer name {name!r} cannot be part of a file name: use a-z, 0-9, . _ and -.")
    if name in CONTROLS and explainer != CONTROLS[name]:
        where = origin_of_explainer(explainer).entry_point
        raise InputError(f"explainer {name!r} ({where}) has the name of a control: rename it.")
    return explainer


def open_policy(name: str, *, trust_code: bool = False) -> tuple[Policy, PolicyCard]:
    """A policy by its name, by the folder or zip of its bundle, or by `module:factory` of its code.

    Raises InputError if there is no such policy, and for code without `trust_code`.
    """
    return ask_policy(name, None, trust_code=trust_code)


def ask_policy(
    name: str, isolation: Isolation | None, *, trust_code: bool = False
) -> tuple[Policy, PolicyCard]:
    """As `open_policy`, but a policy that is code runs in a process of its own.

    isolation: None: in this process. Raises InputError as `open_policy` does, and if the process fails.
    """
    place = place_of(name, trust_code=trust_code)
    if isinstance(place, Path):
        return load_policy(place)
    if isolation is None:
        return run_policy(name, place)
    if place is not None:
        question: dict[str, Any] = {"policy": name, "plugin": (place.name, place.value, place.group)}
        policy, card = open_elsewhere(
            Source(f"policy {name}", None, isolation), question, origin_of_plugin(place, "")
        )
        if card.name != name:
            raise InputError(f"policy plugin {name!r} calls itself {card.name!r}: use one name for both.")
        return policy, card
    name, readable, origin = located(name)
    source = Source(f"policy {Path(name).name}", None, isolation, readable)
    return open_elsewhere(source, {"policy": name, "plugin": None}, origin)
