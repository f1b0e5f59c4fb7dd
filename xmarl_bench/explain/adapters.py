"""`as_explainer`: makes an `Explainer` of a function, a class, an object or an algorithm of PyG.

Arguments are passed by name: a callable gets those of `policy`, `observations` and `generator` that its
parameters name, in any order. Any other parameter needs a default.

    @as_explainer(stochastic=True)
    def noisy(observations, generator): ...

    class Nearest:                       # attributes declare, see `Explainer`; `fit` if needs_fit is True
        accesses = "black-box"
        def explain(self, observations, policy): ...
"""

from __future__ import annotations

import copy
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypedDict, Unpack, overload

import numpy as np
import torch
from torch import Tensor, nn
from torch_geometric.explain import AttentionExplainer, CaptumExplainer, ExplainerAlgorithm, PGExplainer

from xmarl_bench.errors import InputError, a_type, failures_named
from xmarl_bench.explain.declarations import DECLARATIONS, Access, Scalar, check_declared, recordable
from xmarl_bench.explain.explainer import Explainer, Fit
from xmarl_bench.explain.pyg import Copies, PygExplain, fit_pg
from xmarl_bench.explain.simulator import SIMULATOR, Simulator
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.origin.references import Origin, origin_of
from xmarl_bench.policy import Policy

FIT_PARAMETERS = ("policy", "observations", "generator")
PARAMETERS = (*FIT_PARAMETERS, SIMULATOR)


class Declared(TypedDict, total=False):
    """Declarations, as arguments of the decorator or attributes of a class: see `Explainer`."""

    name: str
    summary: str
    stochastic: bool
    slow: bool
    hyperparameters: Mapping[str, Scalar]
    batched: bool
    binary: bool
    signed: bool
    node_importance: bool | None
    needs_fit: bool
    any_device: bool
    accesses: Access | None
    absence: Absence | str | None


_ABSENT: Final = object()  # as None may be what a caller's variable holds by mistake


@overload
def as_explainer(thing: object, /, **declared: Unpack[Declared]) -> Explainer: ...
@overload
def as_explainer(**declared: Unpack[Declared]) -> Callable[[object], Explainer]: ...
def as_explainer(thing: object = _ABSENT, /, **declared: Unpack[Declared]) -> Any:
    """Make an `Explainer` of a function, a class or object that explains, or an algorithm of PyG.

    Also a decorator, with or without arguments. A class is instantiated without arguments; an object explains
    by its method `explain` or by being called, and may declare by attributes, which arguments here override.
    The keywords of a partial are its hyperparameters.
    An `Explainer` is returned unchanged. Raises InputError for anything else, and for invalid declarations.
    """
    if thing is _ABSENT:
        return lambda decorated: as_explainer(decorated, **declared)
    if isinstance(thing, Explainer):
        if declared:
            raise InputError(
                f"explainer {thing.name!r} exists already: declare {', '.join(declared)} where it is made."
            )
        return thing
    if inspect.isclass(thing):
        what = f"explainer {thing.__name__!r} cannot be made without arguments"
        with failures_named(what, "give an instance"):
            made = thing()
        return as_explainer(made, **declared)
    if isinstance(thing, ExplainerAlgorithm):
        return _of_algorithm(thing, declared)
    if inspect.isroutine(thing):
        return _made(thing.__name__, thing, None, {"summary": _first_line(thing)}, declared)
    if isinstance(thing, partial) and inspect.isroutine(thing.func):
        own = {"summary": _first_line(thing.func), "hyperparameters": _scalars(thing.keywords)}
        return _made(thing.func.__name__, thing, None, own, declared)
    explain = getattr(thing, "explain", thing)
    if not callable(explain):
        raise InputError(
            f"{a_type(thing)} is not an explainer: give a function of observations and "
            f"policy, a class with a method explain, or an algorithm of torch_geometric.explain."
        )
    own = {key: getattr(thing, key) for key in DECLARATIONS if hasattr(thing, key)}
    own = {"summary": _first_line(type(thing)), "hyperparameters": _settings(thing), **own}
    return _made(type(thing).__name__, explain, thing, own, declared)


@dataclass(frozen=True)
class Named:
    """Calls `function` with those of policy, observations, generator, simulator that its parameters name."""

    function: Callable[..., Tensor]
    names: tuple[str, ...]

    @classmethod
    def of(cls, name: str, function: Callable[..., Any], given: tuple[str, ...] = PARAMETERS) -> Named:
        """given: what parameters may name. Raises InputError if another parameter has no default."""
        try:
            named = function.forward if isinstance(function, nn.Module) else function
            parameters = list(inspect.signature(named).parameters.values())
        except (TypeError, ValueError):
            raise InputError(
                f"explainer {name!r} has no readable signature: wrap it in a function of observations and "
                f"policy."
            ) from None
        optional = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
        needed = [p for p in parameters if p.default is p.empty and p.kind not in optional]
        taken = [p for p in parameters if p.name in given and p.kind is not p.POSITIONAL_ONLY]
        strange = [p.name for p in needed if p not in taken]
        if strange or not taken:
            got = ", ".join(p.name for p in parameters) or "nothing"
            raise InputError(
                f"explainer {name!r} takes ({got}): name its parameters policy, observations and, if it "
                f"draws random numbers, generator; any other needs a default."
            )
        return cls(function, tuple(p.name for p in taken))

    def __call__(
        self,
        policy: Policy,
        observations: Tensor,
        generator: torch.Generator,
        simulator: Simulator | None = None,
        /,
    ) -> Tensor:
        given = dict(zip(PARAMETERS, (policy, observations, generator, simulator), strict=True))
        return self.function(**{name: given[name] for name in self.names})


def _fit_by_method(
    name: str, owner: Any, policy: Policy, observations: Tensor, generator: torch.Generator
) -> Named:
    """Fits a copy of an object with its method `fit`. The copy then explains."""
    fitted = copy.deepcopy(owner)
    Named.of(name, fitted.fit, FIT_PARAMETERS)(policy, observations, generator)
    return Named.of(name, getattr(fitted, "explain", fitted))


def origin_of_explainer(explainer: Explainer) -> Origin:
    """The explainer's origin: where it was found by name, else where the code of its `explain` is."""
    if explainer.origin is not None:
        return explainer.origin
    explain: object = explainer.explain
    if isinstance(explain, Named):
        explain = explain.function
    if isinstance(explain, PygExplain) and isinstance(explain.algorithm, Copies):
        return origin_of(type(explain.algorithm.algorithm))
    return origin_of(type(explain.__self__) if inspect.ismethod(explain) else explain)


def _made(
    name: str, explain: Callable[..., Any], owner: Any, own: Mapping[str, Any], declared: Declared
) -> Explainer:
    fields: dict[str, Any] = {"name": kebab(name), **own, **declared}
    check_declared(name, fields)
    if fields.get("absence") is not None:
        fields["absence"] = Absence(fields["absence"])
    fit: Fit | None = None
    if fields.pop("needs_fit", False):
        if not callable(getattr(owner, "fit", None)):
            raise InputError(
                f"explainer {name!r} declares needs_fit: give it a method fit of observations and policy."
            )
        Named.of(f"{name}.fit", owner.fit, FIT_PARAMETERS)
        fit = partial(_fit_by_method, fields["name"], owner)
    called = Named.of(name, explain)
    return Explainer(explain=called, simulates=SIMULATOR in called.names, fit=fit, **fields)


def _of_algorithm(algorithm: ExplainerAlgorithm, declared: Declared) -> Explainer:
    """Unmodified, one graph at a time. Captum's explain effects of messages; PGExplainer is fitted first."""
    copies, name = Copies.of(algorithm), kebab(type(algorithm).__name__)
    settings = {**_settings(algorithm), **_scalars(copies.coeffs)}
    fields: dict[str, Any] = {"hyperparameters": settings, "stochastic": True, "slow": True}
    if isinstance(algorithm, AttentionExplainer):
        fields |= {"stochastic": False, "slow": False}
    captum = isinstance(algorithm, CaptumExplainer)
    if captum:
        method = algorithm.attribution_method_class.__name__
        name = f"captum-{kebab(method)}"
        repeated = method in ("IntegratedGradients", "ShapleyValueSampling")  # dozens of forward passes
        fields |= {"signed": True, "slow": repeated, "stochastic": method == "ShapleyValueSampling"}
        fields["hyperparameters"] = _scalars(algorithm.kwargs)
    summary = f"{type(algorithm).__name__} of torch_geometric, unmodified"
    fields |= {"summary": summary, "name": name, **declared}
    check_declared(name, fields)
    if fields.get("accesses") in ("black-box", "attention"):
        raise InputError(
            f"explainer {name!r} declares accesses = {fields['accesses']!r}, but PyG's algorithms run the "
            f"network itself: declare 'gradients' or nothing."
        )
    fit = partial(fit_pg, copies) if isinstance(algorithm, PGExplainer) else None
    if fields.pop("needs_fit", fit is not None) != (fit is not None):
        raise InputError(
            f"explainer {name!r} declares needs_fit = {fit is None}: leave it out, PGExplainer is the only "
            f"algorithm of PyG that is fitted."
        )
    return Explainer(explain=PygExplain(copies, effect=captum), fit=fit, **fields)


def kebab(name: str) -> str:
    """A name safe in files from a name in Python: GNNExplainer -> gnn-explainer, my_own is unchanged."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "-", name)
    return words.lower().lstrip("_<").rstrip(">")


def _settings(thing: object) -> dict[str, Scalar]:
    """The constructor arguments that an object keeps as attributes of the same names."""
    attributes: dict[str, Any] = getattr(thing, "__dict__", {})
    try:
        names = inspect.signature(type(thing)).parameters
    except ValueError:  # a class written in C
        return {}
    return _scalars({name: attributes[name] for name in names if name in attributes})


def _scalars(values: Mapping[str, Any]) -> dict[str, Scalar]:
    """The settings that an entry can record; numpy's numbers as Python's."""
    plain = {key: each.item() if isinstance(each, np.generic) else each for key, each in values.items()}
    return {key: value for key, value in plain.items() if not key.startswith("_") and recordable(value)}


def _first_line(thing: object) -> str:
    return (inspect.getdoc(thing) or "").partition("\n")[0]
