"""Seeds for the successive episodes of one environment."""

from __future__ import annotations

from operator import index

import numpy as np


class EpisodeSeeds:
    """Gives `seed` first, then random seeds that follow from it.

    Without a seed all are random. Entropy is drawn with the first seed, not before, so copies of an unused
    environment (as SuperSuit makes them) differ.

    Raises ValueError if the seed is negative, TypeError if it is not an integer.
    """

    def __init__(self, seed: int | None = None) -> None:
        if seed is not None and index(seed) < 0:
            raise ValueError(f"a seed must be a whole number from 0 on, got {seed}.")
        self._seed = None if seed is None else index(seed)
        self._rng: np.random.Generator | None = None

    def draw(self) -> int:
        """The seed of the next episode: the given one, or one below 2**31 (scoring uses larger ones)."""
        if self._rng is None:
            self._rng = np.random.default_rng(self._seed)
            if self._seed is not None:
                return self._seed
        return int(self._rng.integers(2**31))
