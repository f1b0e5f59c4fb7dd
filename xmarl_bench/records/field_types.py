"""Types of an entry's fields, with the bounds of their values."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import AfterValidator, Field

ROUNDING = 1e-6  # how far rounding may put a number outside its range
DIGITS = 9  # significant digits of an entry's measurements
NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,99}")
# Windows: https://learn.microsoft.com/windows/win32/fileio/naming-a-file
RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?|.*\.", re.IGNORECASE)


def is_file_name(name: str) -> bool:
    """Whether a name can be part of file names on every system."""
    return NAME.fullmatch(name) is not None and RESERVED.fullmatch(name) is None


def rounded(value: Any) -> Any:
    """Every float in tuples, lists and dicts, with DIGITS significant digits; all else as it is."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, tuple):
        return tuple(rounded(each) for each in value)
    if isinstance(value, list):
        return [rounded(each) for each in value]
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    return value


def _not_reserved(name: str) -> str:
    if RESERVED.fullmatch(name):
        raise ValueError(f"{name!r} cannot be a file name on Windows")
    return name


Name = Annotated[str, Field(pattern=f"^{NAME.pattern}$"), AfterValidator(_not_reserved)]


def _one_line(name: str) -> str:
    """The name. Raises ValueError if a table or a spreadsheet could not show it."""
    if not name.isprintable() or name[:1] in ("=", "+", "-", "@"):
        raise ValueError("is not a name in one line of printable characters that begins without = + - @")
    return name


MOST_TEXT = 10_000  # characters
# The name of a person or group, as the board shows it.
Person = Annotated[str, Field(max_length=MOST_TEXT), AfterValidator(_one_line)]
Link = Annotated[str, Field(max_length=2000, pattern=r"^https?://[!-~]+$")]
Text = Annotated[str, Field(max_length=MOST_TEXT)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Agents = Annotated[int, Field(ge=1, le=1024)]
Count = Annotated[int, Field(ge=0, le=10**9)]
Seconds = Annotated[float, Field(ge=0)]
NotNegative = Annotated[float, Field(ge=-ROUNDING)]
