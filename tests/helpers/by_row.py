"""Episodes of an entry's JSON by row and back, for tests that edit a row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def by_row(columns: dict[str, Any], n: int | None = None) -> list[dict[str, Any]]:
    """n: the number of rows; by default that of seeds."""
    n = len(columns["seed"]) if n is None else n
    whole = {
        name: by_row(column, n) if isinstance(column, dict) else [None] * n if column is None else column
        for name, column in columns.items()
    }
    return [{name: column[k] for name, column in whole.items()} for k in range(n)]


def by_column(values: Sequence[Any]) -> Any:
    if all(value is None for value in values):
        return None
    if not any(isinstance(value, dict) for value in values):
        return list(values)
    keys = sorted({key for value in values if value is not None for key in value})
    return {key: by_column([None if value is None else value.get(key) for value in values]) for key in keys}
