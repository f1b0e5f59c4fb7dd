"""Types of an entry's fields: which numbers and texts there can be at all."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

ROUNDING = 1e-6  # by so much a number may be out of its range, for sums round
Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,99}$")]  # safe in file names
Text = Annotated[str, Field(max_length=10_000)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Agents = Annotated[int, Field(ge=1, le=1024)]
Count = Annotated[int, Field(ge=0, le=10**9)]
Seconds = Annotated[float, Field(ge=0)]
NotNegative = Annotated[float, Field(ge=-ROUNDING)]
