"""Finds policies and explainers of every installed package by name.

Explainers: entry points in group `xmarl_bench.explainers`, name -> an `Explainer` of the same name, or
anything that `as_explainer` accepts; also `path/to/file.py:Name` and `module:Name`.
Policies: entry points in group `xmarl_bench.policies`, each -> a function without arguments that returns
{policy name: folder of its bundle, or a function without arguments that returns a `PolicyModule`}. A plugin
that fails to load raises an error with its name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from xmarl_bench.errors import InputError, unknown
from xmarl_bench.explain.adapters import as_explainer, origin_of_explainer
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.origin.installed import package_version
from xmarl_bench.origin.plugins import load_plugin, origin_of_plugin, plugin_error
from xmarl_bench.origin.references import Origin, check_named, is_reference, load_reference
from xmarl_bench.policy import Policy, PolicyCard, load_policy
from xmarl_bench.policy.policy_module import PolicyModule
from xmarl_bench.policy.untrusted import CARD
from xmarl_bench.records.field_types import is_file_name

EXPLAINERS, POLICIES = "xmarl_bench.explainers", "xmarl_bench.policies"


@dataclass(frozen=True)
class PolicyCode:
    """A policy that an installed package makes by running its code."""

    plugin: EntryPoint
    factory: Callable[[], object]

    def __str__(self) -> str:
        return self.plugin.value

    def open(self, name: str) -> tuple[Policy, PolicyCard]:
        """Run the factory. Raises InputError if it returns no policy of that name."""
        made = _made(self.factory, name)
        if made.name != name:
            raise InputError(
                f"policy plugin {name!r} ({self}) calls itself {made.name!r}: use one name for both."
            )
        code = self.factory
        where = f"{code.__module__}:{code.__qualname__}" if hasattr(code, "__qualname__") else None
        return made.open(origin_of_plugin(self.plugin, where))


def explainer_names() -> list[str]:
    """Controls first, then plugins by name. Loads nothing."""
    return [*CONTROLS, *sorted(_explainer_plugins())]


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
        plugin = _explainer_plugin(name)
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


def checked_name(explainer: Explainer) -> Explainer:
    """The explainer. Raises InputError if its name is unsafe in file names or that of a control."""
    name = explainer.name
    if not is_file_name(name):
        raise InputError(f"explainer name {name!r} cannot be part of a file name: use a-z, 0-9, . _ and -.")
    if name in CONTROLS and explainer != CONTROLS[name]:
        where = origin_of_explainer(explainer).entry_point
        raise InputError(f"explainer {name!r} ({where}) has the name of a control: rename it.")
    return explainer


def find_policies() -> dict[str, Path]:
    """Every registered policy that is a bundle: name -> its folder, sorted by name.

    Raises InputError if a plugin does not load.
    """
    policies, failures = registered_policies()
    if failures:
        raise failures[0]
    return {name: place for name, place in policies.items() if isinstance(place, Path)}


def open_policy(name: str, *, trust_code: bool = False) -> tuple[Policy, PolicyCard]:
    """A policy by its name, by the folder or zip of its bundle, or by `module:factory` of its code.

    Raises InputError if there is no such policy, and for code without `trust_code`.
    """
    check_named(name)
    if _is_bundle(name):
        return load_policy(Path(name))
    if is_reference(name):
        _check_trust(name, trust_code)
        factory, origin = load_reference(name)
        return _made(factory, name).open(origin)
    place = _registered_policy(name)
    if isinstance(place, Path):
        return load_policy(place)
    _check_trust(name, trust_code)
    return place.open(name)


def find_policy(name_or_bundle: str) -> Path:
    """The bundle's folder or zip. Raises InputError for an unknown name and for a policy that is code."""
    check_named(name_or_bundle)
    if _is_bundle(name_or_bundle):
        return Path(name_or_bundle)
    place = _registered_policy(name_or_bundle)
    if isinstance(place, PolicyCode):
        raise InputError(f"policy {name_or_bundle!r} is code ({place}) and has no bundle: choose another.")
    return place


def _is_bundle(name: str) -> bool:
    """Whether `name` is a folder with a card, or looks like a path and not like a reference to code."""
    path = Path(name)
    looks_like_one = len(path.parts) > 1 or path.suffix == ".zip"
    return (path / CARD).is_file() or (looks_like_one and not is_reference(name))


def _registered_policy(name: str) -> Path | PolicyCode:
    """A registered policy. Raises InputError for an unknown name: of a plugin that failed to load, if any."""
    policies, failures = registered_policies()
    if name in policies:
        return policies[name]
    if failures:
        raise failures[0]
    raise unknown("policy", name, policies, "or give the folder of a bundle, or module:factory")


def registered_policies() -> tuple[dict[str, Path | PolicyCode], list[InputError]]:
    """Every registered policy by name, and the errors of the plugins that failed to load.

    Raises InputError if two policies have the same name.
    """
    found: dict[str, Path | PolicyCode] = {}
    failures: list[InputError] = []
    for plugin in entry_points(group=POLICIES):
        try:
            places = _places(plugin)
        except InputError as error:
            failures.append(error)
            continue
        for name, place in places.items():
            if name in found:
                raise InputError(
                    f"policy {name!r} is registered twice ({found[name]} and {place}): rename one."
                )
            found[name] = place
    return dict(sorted(found.items())), failures


def _places(plugin: EntryPoint) -> dict[str, Path | PolicyCode]:
    listed = load_plugin(plugin)
    try:
        return {
            str(name): PolicyCode(plugin, place) if callable(place) else Path(place)
            for name, place in listed().items()
        }
    except (Exception, SystemExit) as error:
        raise plugin_error(plugin, error) from error


def _check_trust(name: str, trust_code: bool) -> None:
    if not trust_code:
        raise InputError(
            f"policy {name!r} runs its own code: read it, and add --trust-code (trust_code=True) if you "
            f"trust it."
        )


def _made(factory: object, name: str) -> PolicyModule:
    """What the factory returns. Raises InputError if it fails or returns anything but a PolicyModule."""
    if not callable(factory):
        raise InputError(
            f"policy {name!r} is a {type(factory).__name__}: give a function that returns a PolicyModule."
        )
    try:
        made = factory()
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(
            f"policy {name!r} could not be made ({type(error).__name__}: {error}): correct its factory."
        ) from error
    if not isinstance(made, PolicyModule):
        raise InputError(
            f"policy {name!r} is a {type(made).__name__}: make its factory return a PolicyModule."
        )
    return made


def _explainer_plugin(name: str) -> EntryPoint:
    plugins = _explainer_plugins()
    if name not in plugins:
        raise unknown("explainer", name, [*CONTROLS, *plugins], "or give path/to/file.py:Name or module:Name")
    return plugins[name]


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
