"""The names of the absence models, which `xmarl_bench.explain.absence` defines."""

from __future__ import annotations

from enum import StrEnum


class Absence(StrEnum):
    ZERO = "zero"
    MEAN = "mean"
    RESAMPLE = "resample"
    RENORMALISED = "renormalised"

    @property
    def prefix(self) -> str:
        """The prefix of its metrics in entries. Communication-only metrics use zero."""
        return "comm" if self is Absence.ZERO else self.value
