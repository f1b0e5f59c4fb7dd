"""Numbers with their noun, and the first of many names."""

from __future__ import annotations

from collections.abc import Sequence

NAMED = 3  # of what shares a message


def counted(number: int, noun: str) -> str:
    """`number` and the noun in the form that fits: "1 entry", "2 entries"."""
    if number == 1:
        return f"1 {noun}"
    return f"{number} {noun[:-1]}ies" if noun.endswith("y") else f"{number} {noun}s"


def first_of(names: Sequence[str], most: int) -> str:
    """At most so many of the names, and how many more there are: "a, b and 3 more"."""
    listed = ", ".join(names[:most])
    return f"{listed} and {len(names) - most} more" if len(names) > most else listed
