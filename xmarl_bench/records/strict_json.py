"""A strict parser for JSON of unknown origin: refuses what is ambiguous or could exhaust the reader.

Python's parser accepts NaN, turns 1e999 into infinity, keeps the last of two equal keys and reads any size.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NoReturn

from xmarl_bench.errors import InputError

if TYPE_CHECKING:
    from pydantic import ValidationError

MAX_BYTES = 16 * 1024 * 1024
# Bounds the time of validation: each delimiter adds at most one value, at some microseconds each.
MAX_VALUES = 200_000
MAX_DIGITS = 19  # of an integer; other languages read integers exactly up to 2**53, of 16 digits
_LONG = re.compile(rb"[:,\[](?:-[0-9]{%d}|[0-9]{%d})" % (MAX_DIGITS + 1, MAX_DIGITS + 2))


def parse_json(data: bytes, *, max_bytes: int = MAX_BYTES) -> Any:
    """Parse strict JSON text in UTF-8.

    Raises ValueError if the text is not JSON, holds NaN, infinity or a key twice, or has too many bytes,
    levels (about a thousand) or values. The message is a clause without a full stop.
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
        raise ValueError(f"is not JSON ({error.msg} in line {error.lineno})") from None
    except RecursionError:
        raise ValueError("is nested too deep") from None


def check_size(data: bytes, max_bytes: int = MAX_BYTES) -> None:
    """Raise ValueError, as `parse_json` does, for too many bytes or values."""
    if len(data) > max_bytes:
        raise ValueError(f"holds {len(data)} bytes, more than the limit of {max_bytes}")
    if data.count(b",") + data.count(b"[") + data.count(b"{") > MAX_VALUES:
        raise ValueError(f"holds more values than the limit of {MAX_VALUES}")


def has_long_integer(text: bytes) -> bool:
    """Whether canonical JSON holds an integer too long for `parse_json`, or a string that looks like one."""
    return _LONG.search(text) is not None


def shown(value: object, length: int = 80) -> str:
    """Untrusted text made safe for a terminal or log: a literal in printable ASCII, one line, shortened."""
    line = ascii(str(value) if isinstance(value, BaseException) else value)
    return line if len(line) <= length else line[: length - 4] + "..." + line[-1]


def printable(name: object) -> str:
    """A file's name for a terminal or log: quoted and escaped if it could be more than text there.

    GitHub's runner takes a line of output that begins with `::` or holds `##[` as a command.
    """
    text = str(name)
    return text if text.isprintable() and "::" not in text and "##[" not in text else shown(text, 300)


def first_error(error: ValidationError) -> tuple[str, str]:
    """Message and place of pydantic's first error. Place: names joined by dots, empty for the whole value.

    Both may quote the value: pass them through `shown` if the value is untrusted.
    """
    first = error.errors(include_url=False, include_input=False, include_context=False)[0]
    return first["msg"], ".".join(str(part) for part in first["loc"])


@contextmanager
def fields_named(whose: str) -> Iterator[None]:
    """Raises InputError for pydantic's error in the block, such as "the policy's name is invalid: ..."."""
    from pydantic import ValidationError

    try:
        yield
    except ValidationError as error:
        problem, where = first_error(error)
        raise InputError(f"{whose} {where} is invalid: {problem}.") from None


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"has the key {shown(twice)} twice in one object")
    return value


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"holds {text}, which is not a JSON number")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"holds the number {shown(text, 24)}, which is too large")
    return value


def _short(text: str) -> int:
    if len(text) > MAX_DIGITS + 1:
        raise ValueError(f"holds an integer of {len(text)} digits")
    return int(text)
