"""Entry points of installed packages: loads what they name, and says which distribution they belong to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from importlib.metadata import EntryPoint
from typing import Any

from xmarl_bench.errors import InputError, failures_named
from xmarl_bench.origin.references import Origin


def plugins_by_name(
    registered: Iterable[EntryPoint], what: str, taken: Mapping[str, str]
) -> dict[str, EntryPoint]:
    """Entry points by name, sorted. Loads nothing. Raises InputError if two share a name.

    what: an entry point names, for messages. taken: names that ours have, with what has each of them.
    """
    plugins: dict[str, EntryPoint] = {}
    for plugin in registered:
        other = plugins[plugin.name].value if plugin.name in plugins else taken.get(plugin.name)
        if other is not None:
            raise InputError(f"{what} {plugin.name!r} ({plugin.value}) has the name of {other}: rename one.")
        plugins[plugin.name] = plugin
    return dict(sorted(plugins.items()))


def load_plugin(plugin: EntryPoint) -> Any:
    """What the entry point names. Runs its module. Raises InputError if it does not load."""
    with plugin_failures(plugin):
        return plugin.load()


def plugin_failures(plugin: EntryPoint) -> AbstractContextManager[None]:
    """While code of a plugin runs: raises InputError, naming the plugin, for what it raises."""
    name = None if plugin.dist is None else plugin.dist.name
    where = f"{plugin.value}, of {name or 'an unknown distribution'}"
    return failures_named(f"plugin {plugin.name!r} ({where}) failed to load", "correct or uninstall it")


def origin_of_plugin(plugin: EntryPoint, where: str | None = None) -> Origin:
    """The origin of what the entry point names. where: "module:Name", by default the entry point's own."""
    name, version = (None, None) if plugin.dist is None else (plugin.dist.name, plugin.dist.version)
    return Origin(name, version, plugin.value if where is None else where)
