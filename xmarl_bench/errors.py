"""The exception for invalid input."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from operator import index

MANY = 50  # names in a message


class InputError(ValueError):
    """Invalid input: what was wrong, what was received, what to do. The CLI prints it and exits 2."""


def a_type(value: object) -> str:
    """The name of its type with an article, as "an Explanation"."""
    name = type(value).__name__
    return f"{'an' if name.lower().startswith(('a', 'e', 'i', 'o')) else 'a'} {name}"


@contextmanager
def failures_named(what: str, remedy: str) -> Iterator[None]:
    """While others' code runs: raises what it raises as an InputError, "WHAT (the exception): REMEDY."."""
    try:
        yield
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}".rstrip(". \n")
        raise InputError(f"{what} ({reason}): {remedy}.") from error


def whole_number(name: str, value: object) -> int:
    """The value as an int, also of numpy's whole numbers. Raises InputError for anything else."""
    try:
        return int(index(value))  # type: ignore[arg-type]
    except TypeError:
        raise InputError(f"{name} must be a whole number, got {value!r}: give one.") from None


def unknown(kind: str, name: str, choices: Iterable[str], hint: str = "") -> InputError:
    """The error for a name that is not among the choices: the nearest, then all, or some if they are many."""
    listed = [str(each) for each in choices]
    near = difflib.get_close_matches(name, listed, n=3)
    choose = f"did you mean {near[0]!r}? Choose" if near else "choose"
    shown = listed if len(listed) <= MANY else near or listed[:3]
    more = f" and {len(listed) - len(shown)} more" if len(shown) < len(listed) else ""
    others = f"{choose} one of {', '.join(shown)}{more}" if listed else "none is installed"
    return InputError(f"unknown {kind} {name!r}: {others}{', ' + hint if hint else ''}.")
