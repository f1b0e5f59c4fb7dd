"""JSON as a program writes it for programs: what is ambiguous or could exhaust a reader is refused.

Python's parser takes NaN, turns 1e999 into infinity, keeps the last of two equal keys and reads whatever size
it is given; files of strangers are read with none of that.
"""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from pydantic import ValidationError

MAX_BYTES = 16 * 1024 * 1024
# Each delimiter is at most one more value to validate, at some microseconds each: a bound on time.
MAX_VALUES = 200_000
MAX_DIGITS = 19  # of an integer: more than 2**53, which readers in other languages keep exact
_LONG = re.compile(rb"[:,\[](?:-[0-9]{%d}|[0-9]{%d})" % (MAX_DIGITS + 1, MAX_DIGITS + 2))


def parse_json(data: bytes, *, max_bytes: int = MAX_BYTES) -> Any:
    """The value of strict JSON text in UTF-8.

    Raises ValueError, whose text is a clause without a full stop, for what is no JSON, holds NaN, infinity or
    one key twice, or is too large, too deep (about a thousand levels) or of too many values.
    """
    check_size(data, max_bytes)
    try:
        return json.loads(
            data.decode(),
            object_pairs_hook=_unique,
            parse_constant=_no_constant,
            parse_float=_finite,
            parse_int=_short,
        )
    except UnicodeDecodeError:
        raise ValueError("is not text in UTF-8") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"is no JSON ({error.msg} in line {error.lineno})") from None
    except RecursionError:
        raise ValueError("is nested too deep") from None


def check_size(data: bytes, max_bytes: int = MAX_BYTES) -> None:
    """Raises ValueError, as `parse_json` does, for too many bytes or values."""
    if len(data) > max_bytes:
        raise ValueError(f"holds {len(data)} bytes, more than the {max_bytes} that are read")
    if data.count(b",") + data.count(b"[") + data.count(b"{") > MAX_VALUES:
        raise ValueError(f"holds more than the {MAX_VALUES} values that are read")


def has_long_integer(text: bytes) -> bool:
    """Whether canonical JSON holds an integer that `parse_json` refuses, or a string that looks like it."""
    return _LONG.search(text) is not None


def shown(value: object, length: int = 80) -> str:
    """What a stranger wrote, for a terminal or a log: as a literal, printable ASCII, one line, shortened."""
    line = ascii(str(value) if isinstance(value, BaseException) else value)
    return line if len(line) <= length else line[: length - 4] + "..." + line[-1]


def first_error(error: ValidationError) -> tuple[str, str]:
    """What pydantic found first, and where: names joined by dots, empty for the whole value.

    Both may quote the value: they are for `shown` where a stranger wrote it.
    """
    first = error.errors(include_url=False, include_input=False, include_context=False)[0]
    return first["msg"], ".".join(str(part) for part in first["loc"])


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"has the key {shown(twice)} twice in one object")
    return value


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"holds {text}, which is no JSON number")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"holds the number {shown(text, 24)}, which is too large")
    return value


def _short(text: str) -> int:
    if len(text) > MAX_DIGITS + 1:
        raise ValueError(f"holds an integer of {len(text)} digits")
    return int(text)
