"""Explainers of others, asked over a pipe: each runs in a process of its own, and the harness measures.

A process answers a whole episode at a time. It keeps the policies that it was sent and the explainers that it
has fitted.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, NoReturn

from pydantic import Field

from xmarl_bench.entry.schema import ExplainerRecord
from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import origin_of_explainer
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.simulator import SIMULATOR
from xmarl_bench.isolation.asked import Asked
from xmarl_bench.isolation.conversation import Isolation, Source, conversation, reading_answer, sendable
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.origin.code_hash import object_sha256
from xmarl_bench.origin.references import Origin
from xmarl_bench.records.field_types import Text

# Fields of an Explainer that are declared under their own names.
DECLARED = (
    "name", "summary", "stochastic", "slow", "control", "hyperparameters", "batched", "binary", "signed",
    "node_importance", "absence", "any_device",
)  # fmt: skip


class Declared(ExplainerRecord):
    """What a process declares of its explainer."""

    slow: bool
    summary: Text
    absence: Absence | None
    signed: bool  # type: ignore[assignment]
    any_device: bool
    key: Text | None
    hyperparameters: Annotated[dict[Text, bool | int | float | Text | None], Field(max_length=100)]


def isolate(explainer: Explainer, isolation: Isolation) -> Explainer:
    """The same explainer, asked over a pipe: it is sent to its process by value.

    Raises InputError if it cannot be pickled.
    """
    content = sendable(f"explainer {explainer.name!r}", replace(explainer, elsewhere=None))
    key = object_sha256(replace(explainer, summary="", origin=None)) or secrets.token_hex()
    source = Source(f"explainer {explainer.name}", {"what": "load", "pickled": content}, isolation)
    return replace(
        explainer,
        explain=_not_here,
        fit=None if explainer.fit is None else _not_here,
        origin=explainer.origin or origin_of_explainer(explainer),
        elsewhere=Asked(source, key, explainer.device),
    )


def find_elsewhere(
    name: str, origin: Origin | None, readable: Sequence[Path], isolation: Isolation
) -> Explainer:
    """An explainer by name or reference, loaded in a process of its own and never here.

    origin: where it comes from, if it is known without asking. Raises InputError if it does not load.
    """
    load = {"what": "load", "explainer": name}
    source = Source(f"explainer {Path(name).name}", load, isolation, tuple(readable))
    header = conversation(source).declared
    with reading_answer(source):
        declared = Declared.model_validate(header, strict=False)
    its_own = Origin(declared.distribution, declared.version, declared.entry_point, declared.code_sha256)
    return Explainer(
        **{field: getattr(declared, field) for field in DECLARED},
        explain=_not_here,
        simulates=declared.accesses == SIMULATOR,
        accesses=None if declared.accesses == SIMULATOR else declared.accesses,
        fit=_not_here if declared.needs_fit else None,
        origin=origin or its_own,
        elsewhere=Asked(replace(source, key=declared.key), declared.key or secrets.token_hex()),
    )


def _not_here(*_: object) -> NoReturn:
    raise InputError("this explainer runs in a process of its own: call it by `run_explainer`.")
