"""Entry points of installed packages: loads what they name, and says which distribution they belong to."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

from xmarl_bench.errors import InputError
from xmarl_bench.origin.references import Origin


def load_plugin(plugin: EntryPoint) -> Any:
    """What the entry point names. Runs its module. Raises InputError if it does not load."""
    try:
        return plugin.load()
    except (Exception, SystemExit) as error:
        raise plugin_error(plugin, error) from error


def plugin_error(plugin: EntryPoint, error: BaseException) -> InputError:
    """The error of an entry point that does not load."""
    name = None if plugin.dist is None else plugin.dist.name
    return InputError(
        f"plugin {plugin.name!r} ({plugin.value}, of {name or 'an unknown distribution'}) failed to load "
        f"({type(error).__name__}: {error}): correct or uninstall it."
    )


def origin_of_plugin(plugin: EntryPoint, where: str | None = None) -> Origin:
    """The origin of what the entry point names. where: "module:Name", by default the entry point's own."""
    name, version = (None, None) if plugin.dist is None else (plugin.dist.name, plugin.dist.version)
    return Origin(name, version, plugin.value if where is None else where)
