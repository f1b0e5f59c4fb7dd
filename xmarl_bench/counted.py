"""Numbers with their noun."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """`number` and the noun in the form that fits: "1 entry", "2 entries"."""
    if number == 1:
        return f"1 {noun}"
    return f"{number} {noun[:-1]}ies" if noun.endswith("y") else f"{number} {noun}s"
