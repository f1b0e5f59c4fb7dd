"""Reads the fields of pickled dataclasses without unpickling them: imports nothing, calls nothing.

Interprets the instructions by which pickle writes plain values and instances with a `__dict__`. An instance
becomes a `PickledRecord`, and a class or function its name.
"""

from __future__ import annotations

import io
import pickletools
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

CONSTANTS: Final = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
VALUES: Final = {"BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "SHORT_BINUNICODE", "BINUNICODE"}
IGNORED: Final = {"PROTO", "FRAME", "STOP"}
TUPLES: Final = {"EMPTY_TUPLE": 0, "TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


class PickledName(NamedTuple):
    """A class or function."""

    module: str
    name: str


@dataclass
class PickledRecord:
    """An instance: its class and attributes."""

    made_by: Any  # a PickledName; anything in a hostile file
    fields: dict[str, Any] = field(default_factory=dict)


def read_records(data: bytes) -> list[Any]:
    """The values of a file of one or more pickles. Raises ValueError for any other instruction."""
    file, values = io.BytesIO(data), []
    while file.tell() < len(data):
        stack: list[Any] = []
        marks: list[int] = []
        memo: list[Any] = []
        try:
            for opcode, argument, _ in pickletools.genops(file):
                _step(opcode.name, argument, stack, marks, memo)
            values.append(stack.pop())
        except (IndexError, AttributeError, TypeError) as error:
            raise ValueError(f"not a pickle of plain records ({error})") from None
    return values


def _step(name: str, argument: Any, stack: list[Any], marks: list[int], memo: list[Any]) -> None:
    if name in IGNORED:
        return
    if name in CONSTANTS:
        stack.append(CONSTANTS[name])
    elif name in VALUES:
        stack.append(argument)
    elif name in ("EMPTY_DICT", "EMPTY_LIST"):
        stack.append({} if name == "EMPTY_DICT" else [])
    elif name in TUPLES:
        n = TUPLES[name]
        stack.append(tuple(stack.pop() for _ in range(n))[::-1])
    elif name == "MEMOIZE":
        memo.append(stack[-1])
    elif name in ("BINGET", "LONG_BINGET"):
        stack.append(memo[argument])
    elif name == "MARK":
        marks.append(len(stack))
    elif name in ("TUPLE", "APPENDS", "SETITEMS"):
        start = marks.pop()
        items = stack[start:]
        del stack[start:]
        _put(name, items, stack)
    elif name in ("APPEND", "SETITEM"):
        n = 1 if name == "APPEND" else 2
        items = [stack.pop() for _ in range(n)][::-1]
        _put(f"{name}S", items, stack)
    elif name == "STACK_GLOBAL":
        of, module = stack.pop(), stack.pop()
        stack.append(PickledName(_text(module), _text(of)))
    elif name in ("NEWOBJ", "REDUCE"):
        stack.pop()  # arguments
        stack.append(PickledRecord(stack.pop()))
    elif name == "BUILD":
        fields = stack.pop()
        if not isinstance(fields, dict):
            raise ValueError("not a pickle of plain records (a state that is not a dict)")
        stack[-1].fields.update(fields)
    else:
        raise ValueError(f"not a pickle of plain records (instruction {name})")


def _put(name: str, items: list[Any], stack: list[Any]) -> None:
    if name == "TUPLE":
        stack.append(tuple(items))
    elif name == "APPENDS":
        stack[-1].extend(items)
    else:
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, str | int):
                raise ValueError("not a pickle of plain records (a key that is neither text nor number)")
            stack[-1][key] = value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError("not a pickle of plain records (a name that is not text)")
    return value
