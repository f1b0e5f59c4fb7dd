"""The names of the absence models; `xmarl_bench.explain.absence` says what each puts in a message's place."""

from __future__ import annotations

from enum import StrEnum


class Absence(StrEnum):
    ZERO = "zero"
    MEAN = "mean"
    RESAMPLE = "resample"
    RENORMALISED = "renormalised"

    @property
    def prefix(self) -> str:
        """Of what entries name by it. Zero is that of all communication-only metrics."""
        return "comm" if self is Absence.ZERO else self.value
