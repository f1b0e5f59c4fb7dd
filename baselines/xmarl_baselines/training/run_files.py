"""Reads the files of a training run, and names those that are damaged."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from xmarl_bench.errors import InputError

Value = TypeVar("Value")


def read_run_file(path: Path, take: Callable[[Any], Value]) -> Value:
    """What `take` makes of the JSON of a file. Raises InputError if the file is not what a run writes."""
    try:
        return take(json.loads(path.read_bytes()))
    except (ValueError, KeyError, TypeError):
        raise damaged(path) from None


def damaged(path: Path) -> InputError:
    return InputError(f"{path} is damaged: remove the folder of this run, and train it from its beginning.")
