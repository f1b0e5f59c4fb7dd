"""Types of an entry's fields, with the bounds of their values."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

ROUNDING = 1e-6  # how far rounding may put a number outside its range
Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,99}$")]  # safe in file names
Text = Annotated[str, Field(max_length=10_000)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Agents = Annotated[int, Field(ge=1, le=1024)]
Count = Annotated[int, Field(ge=0, le=10**9)]
Seconds = Annotated[float, Field(ge=0)]
NotNegative = Annotated[float, Field(ge=-ROUNDING)]
