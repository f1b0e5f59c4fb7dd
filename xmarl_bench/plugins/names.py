"""Names of the policies and explainers of every installed package. Loads no explainer and no network.

Explainers: entry points in group `xmarl_bench.explainers`, name -> an `Explainer` of the same name, or
anything that `as_explainer` accepts. Policies: entry points in group `xmarl_bench.policies`, each -> a
function without arguments that returns {policy name: folder of its bundle, or a function without arguments
that returns a `PolicyModule`}; the first of these functions runs here if we ship it, else in a process of
its own, and the second nowhere.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from xmarl_bench.errors import InputError, unknown
from xmarl_bench.explain.control_names import SUMMARIES as CONTROL_NAMES
from xmarl_bench.isolation.limits import UNLIMITED
from xmarl_bench.isolation.process import Stranger
from xmarl_bench.origin.plugins import load_plugin, plugin_failures, plugins_by_name
from xmarl_bench.origin.references import check_named, is_reference
from xmarl_bench.policy.untrusted import CARD

OURS = "xmarl-bench"  # the distribution whose code runs in the harness's process
EXPLAINERS, POLICIES = "xmarl_bench.explainers", "xmarl_bench.policies"


Place = Path | EntryPoint  # of a policy: the folder or zip of its bundle, or the plugin whose code makes it


def explainer_names() -> list[str]:
    """Controls first, then plugins by name. Loads nothing."""
    return [*CONTROL_NAMES, *explainer_plugins()]


def is_shipped(name: str) -> bool:
    """Whether the explainer of that name is a control, or of this distribution. Loads nothing."""
    if name in CONTROL_NAMES:
        return True
    registered = entry_points(group=EXPLAINERS, name=name)
    return bool(registered) and all(each.dist is not None and each.dist.name == OURS for each in registered)


def explainer_plugin(name: str) -> EntryPoint:
    plugins = explainer_plugins()
    if name not in plugins:
        raise unknown(
            "explainer", name, [*CONTROL_NAMES, *plugins], "or give path/to/file.py:Name or module:Name"
        )
    return plugins[name]


def explainer_plugins() -> dict[str, EntryPoint]:
    controls = dict.fromkeys(CONTROL_NAMES, "a control of xmarl-bench")
    return plugins_by_name(entry_points(group=EXPLAINERS), "explainer", controls)


def find_policies() -> dict[str, Path]:
    """Every registered policy that is a bundle: name -> its folder, sorted by name.

    Raises InputError if a plugin does not load.
    """
    policies, failures = registered_policies()
    if failures:
        raise failures[0]
    return {name: place for name, place in policies.items() if isinstance(place, Path)}


def find_policy(name_or_bundle: str) -> Path:
    """The bundle's folder or zip. Raises InputError for an unknown name and for a policy that is code."""
    check_named(name_or_bundle)
    if _is_bundle(name_or_bundle):
        return Path(name_or_bundle)
    place = _registered_policy(name_or_bundle)
    if isinstance(place, EntryPoint):
        raise InputError(
            f"policy {name_or_bundle!r} is code ({place.value}) and has no bundle: choose another."
        )
    return place


def place_of(name: str, *, trust_code: bool = False) -> Place | None:
    """The bundle of a policy, or its code; None for a reference `module:factory`, which is not loaded.

    Raises InputError if there is no such policy, and for code without `trust_code`.
    """
    check_named(name)
    if _is_bundle(name):
        return Path(name)
    place = None if is_reference(name) else _registered_policy(name)
    if not isinstance(place, Path) and not trust_code:
        raise InputError(
            f"policy {name!r} runs its own code: read it, and add --trust-code (trust_code=True) if you "
            f"trust it."
        )
    return place


def _is_bundle(name: str) -> bool:
    """Whether `name` is a folder with a card, or looks like a path and not like a reference to code."""
    path = Path(name)
    looks_like_one = len(path.parts) > 1 or path.suffix == ".zip"
    return (path / CARD).is_file() or (looks_like_one and not is_reference(name))


def _registered_policy(name: str) -> Place:
    """A registered policy. Raises InputError for an unknown name: of a plugin that failed to load, if any."""
    policies, failures = registered_policies()
    if name in policies:
        return policies[name]
    if failures:
        raise failures[0]
    raise unknown("policy", name, policies, "or give the folder of a bundle, or module:factory")


def registered_policies() -> tuple[dict[str, Place], list[InputError]]:
    """Every registered policy by name, and the errors of the plugins that failed to load.

    Raises InputError if two policies have the same name.
    """
    found: dict[str, Place] = {}
    failures: list[InputError] = []
    for plugin in entry_points(group=POLICIES):
        try:
            places = _places(plugin)
        except InputError as error:
            failures.append(error)
            continue
        for name, place in places.items():
            if name in found:
                one, other = (each if isinstance(each, Path) else each.value for each in (found[name], place))
                raise InputError(f"policy {name!r} is registered twice ({one} and {other}): rename one.")
            found[name] = place
    return dict(sorted(found.items())), failures


def shipped_policies() -> dict[str, Path]:
    """The bundles of this distribution's policies by name. Runs no code of others."""
    ours = [plugin for plugin in entry_points(group=POLICIES) if _is_ours(plugin)]
    places = {name: place for plugin in ours for name, place in places_of_plugin(plugin).items()}
    return {name: place for name, place in sorted(places.items()) if isinstance(place, Path)}


def _is_ours(plugin: EntryPoint) -> bool:
    return plugin.dist is None or plugin.dist.name == OURS


def _places(plugin: EntryPoint) -> dict[str, Place]:
    """The policies of a plugin, which is loaded in a process of its own if another package registered it."""
    if _is_ours(plugin):
        places = places_of_plugin(plugin)
        return {name: place if isinstance(place, Path) else plugin for name, place in places.items()}
    return _places_elsewhere(plugin)


@cache  # a package does not change while it is imported, and a process takes up to five seconds
def _places_elsewhere(plugin: EntryPoint) -> dict[str, Place]:
    with Stranger(f"plugin {plugin.name} ({plugin.value})", UNLIMITED, "process", light=True) as process:
        plain = plugin.name, plugin.value, plugin.group
        listed, _ = process.ask({"what": "policies", "plugin": plain})
    folders, code = listed.get("folders"), listed.get("code")
    if not isinstance(folders, dict) or not isinstance(code, list):
        raise InputError(f"policy plugin {plugin.name!r} lists no policies: correct or uninstall it.")
    found: dict[str, Place] = {str(name): Path(str(folder)) for name, folder in folders.items()}
    return found | {str(name): plugin for name in code}


def places_of_plugin(plugin: EntryPoint) -> dict[str, Path | Callable[[], object]]:
    """Folders of bundles and factories of policies, by name. Runs the plugin. Raises InputError."""
    listed = load_plugin(plugin)
    with plugin_failures(plugin):
        return {str(name): place if callable(place) else Path(place) for name, place in listed().items()}
