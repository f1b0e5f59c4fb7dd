"""How far apart numbers of an entry may be that are equal up to rounding."""

from __future__ import annotations

from typing import Final

# Relative to the larger of 1 and the number: three numbers of DIGITS digits, below 10, are each 5e-9 off.
CLOSE: Final = 2e-8
ALIKE: Final = 1e-5  # difference of actions of the same mask in another batch


def close(one: float, other: float, factor: float = 1.0) -> bool:
    """Whether two numbers are equal up to rounding. factor: by how much they exaggerate their inputs'."""
    return abs(one - other) <= factor * CLOSE * max(1.0, abs(one), abs(other))
