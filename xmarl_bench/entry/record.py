"""The base of all parts of an entry: strict, frozen, without unknown fields, NaN or infinity."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def left_out() -> Any:
    """The default of a field that is None in older entries: left out of the text then, so ids stay."""
    return Field(default=None, exclude_if=lambda value: value is None)
