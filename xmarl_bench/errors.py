"""The exception for invalid input."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Invalid input: what was wrong, what was received, what to do. The CLI prints it and exits 2."""


def unknown(kind: str, name: str, choices: Iterable[str], hint: str = "") -> InputError:
    """The error for a name that is not among the choices: the nearest choice, then all of them."""
    listed = [str(each) for each in choices]
    near = difflib.get_close_matches(name, listed, n=1)
    choose = f"did you mean {near[0]!r}? Choose" if near else "choose"
    others = f"{choose} one of {', '.join(listed)}" if listed else "none is installed"
    return InputError(f"unknown {kind} {name!r}: {others}{', ' + hint if hint else ''}.")
