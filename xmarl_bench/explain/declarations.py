"""What an explainer declares, and which values are valid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, Literal, get_args

from xmarl_bench.errors import InputError
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.records.field_types import MOST_TEXT
from xmarl_bench.records.strict_json import MAX_DIGITS, shown

Scalar = bool | int | float | str | None
TOO_LARGE: Final[int] = 10**MAX_DIGITS  # of an entry's whole numbers
Access = Literal["black-box", "attention", "gradients"]
FLAGS = ("stochastic", "slow", "batched", "binary", "signed", "needs_fit", "any_device")
DECLARATIONS = ("name", "summary", "hyperparameters", "accesses", "absence", "node_importance", *FLAGS)


def recordable(value: object) -> bool:
    """Whether an entry can record the value as a hyperparameter."""
    if isinstance(value, bool) or value is None:
        return True
    if isinstance(value, int):
        return abs(value) < TOO_LARGE
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, str) and len(value) <= MOST_TEXT


def check_declared(name: str, fields: Mapping[str, Any]) -> None:
    """Raise InputError for an unknown declaration or an invalid value."""
    for key, value in fields.items():
        if key not in DECLARATIONS:
            raise InputError(f"explainer {name!r} declares {key!r}: choose among {', '.join(DECLARATIONS)}.")
        if key == "accesses":
            right, wanted = value in (None, *get_args(Access)), f"one of {', '.join(get_args(Access))}"
        elif key == "absence":
            right, wanted = value in (None, *Absence), f"one of {', '.join(Absence)}"
        elif key == "hyperparameters":
            right = isinstance(value, Mapping) and all(map(_is_name, value))
            right = right and all(map(recordable, value.values()))
            wanted = "a dict of names and finite numbers, strings, booleans or None"
        elif key in FLAGS:
            right, wanted = isinstance(value, bool), "True or False"
        elif key == "node_importance":
            right, wanted = value is None or isinstance(value, bool), "True, False or None"
        else:
            right, wanted = isinstance(value, str), "a string"
        if not right:
            raise InputError(f"explainer {name!r} declares {key} = {shown(value)}: give {wanted}.")


def _is_name(key: object) -> bool:
    return isinstance(key, str) and len(key) <= MOST_TEXT
