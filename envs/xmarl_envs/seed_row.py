"""Which seeds the episodes of one environment get when they follow one another."""

from __future__ import annotations

from operator import index

import numpy as np


class SeedRow:
    """Seeds of a row of episodes: `seed` itself, then random numbers that follow from it.

    Without a seed all of them are random, drawn from fresh entropy when the first is asked for and not
    before: copies of an environment made ahead of its first episode (as SuperSuit makes them) differ.

    Raises ValueError for a negative seed, TypeError for one that is no whole number.
    """

    def __init__(self, seed: int | None = None) -> None:
        if seed is not None and index(seed) < 0:
            raise ValueError(f"a seed must be a whole number from 0 on, got {seed}.")
        self._seed = None if seed is None else index(seed)
        self._rng: np.random.Generator | None = None

    def draw(self) -> int:
        """The seed of the next episode: the one that was given, or one below 2**31 (scoring's lie above)."""
        if self._rng is None:
            self._rng = np.random.default_rng(self._seed)
            if self._seed is not None:
                return self._seed
        return int(self._rng.integers(2**31))
