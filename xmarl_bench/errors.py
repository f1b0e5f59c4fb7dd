"""The one exception that means "what you gave me is wrong"."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Bad input, said in one sentence: what was wrong, what was received, what to do. The CLI exits 2."""


def unknown(kind: str, name: str, choices: Iterable[str], hint: str = "") -> InputError:
    """The error for a name that is not among the choices; it suggests the nearest one."""
    listed = list(choices)
    near = difflib.get_close_matches(name, listed, n=1)
    guess = f" Did you mean {near[0]!r}?" if near else ""
    others = f"choose one of {', '.join(listed)}" if listed else "none is installed"
    return InputError(f"unknown {kind} {name!r}: {others}{', ' + hint if hint else ''}.{guess}")
