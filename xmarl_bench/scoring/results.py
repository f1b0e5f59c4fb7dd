"""Results of pieces: in the cache as bytes, and the most recent ones in memory.

Episodes are stored as safetensors, all other results as JSON, which keeps numbers bit for bit.
"""

from __future__ import annotations

import sys
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import TypeAdapter
from safetensors import SafetensorError
from safetensors.numpy import load, save

from xmarl_bench.errors import InputError
from xmarl_bench.rollout.episodes import Episode
from xmarl_bench.scoring.behaviour import Played
from xmarl_bench.scoring.cache import Cache
from xmarl_bench.scoring.measure import Explained, Shared
from xmarl_bench.scoring.pieces import Kind, Piece

Result = list[Episode] | list[Shared] | list[Explained] | Played
SCALARS = ("reward", "success_rate", "no_agent_collision", "no_object_collision")
JSON: dict[Kind, TypeAdapter[Any]] = {
    "shared": TypeAdapter(list[Shared]),
    "explained": TypeAdapter(list[Explained]),
    "behaviour": TypeAdapter(Played),
    "absences": TypeAdapter(Played),
}
PLAYED: tuple[Kind, ...] = ("episodes", "mute")
MEMORY = 64 * 2**20  # bytes, by the size of their files


class Results:
    """The results of pieces. The last ones written or read stay in memory, so their files are read once."""

    def __init__(self, cache: Cache) -> None:
        self.cache = cache
        self._recent: OrderedDict[str, tuple[Result, int]] = OrderedDict()
        self._size = 0

    def has(self, piece: Piece) -> bool:
        return self._find(piece) is not None

    def write(self, piece: Piece, result: Any) -> None:
        data = _encode_episodes(result) if piece.kind in PLAYED else JSON[piece.kind].dump_json(result)
        self.cache.write(piece.key, data)
        self._remember(piece, result, len(data))

    def get(self, piece: Piece) -> Any:
        """The piece's `Result`, whose type its kind tells. Raises InputError if it is missing."""
        result = self._find(piece)
        if result is None:
            raise InputError(
                f"{self.cache.path(piece.key)} ({piece}) was deleted or changed: run the same command again "
                f"to compute it."
            )
        return result

    def _find(self, piece: Piece) -> Result | None:
        if piece.key in self._recent:
            self._recent.move_to_end(piece.key)
            return self._recent[piece.key][0]
        data = self.cache.read(piece.key)
        if data is None:
            return None
        try:
            result: Result = _decode(piece, data)
        except (SafetensorError, LookupError, TypeError, ValueError):
            path = self.cache.path(piece.key)
            print(f"{path} does not hold the result of {piece}: it is computed anew.", file=sys.stderr)
            return None
        self._remember(piece, result, len(data))
        return result

    def _remember(self, piece: Piece, result: Result, size: int) -> None:
        self._size += size - self._recent.pop(piece.key, (None, 0))[1]
        self._recent[piece.key] = result, size
        while self._size > MEMORY:
            self._size -= self._recent.popitem(last=False)[1][1]


def _decode(piece: Piece, data: bytes) -> Any:
    """The result. Raises LookupError, TypeError, ValueError or SafetensorError if the data is not of it."""
    if piece.kind in PLAYED:
        return _decode_episodes(data, piece.block.seeds)
    result = JSON[piece.kind].validate_json(data)
    n = len(result.rows if isinstance(result, Played) else result)
    if n != len(piece.block.seeds):
        raise ValueError(f"{n} results of {len(piece.block.seeds)} episodes")
    return result


def _encode_episodes(episodes: Sequence[Episode]) -> bytes:
    arrays = {f"observations.{k}": np.ascontiguousarray(each.observations) for k, each in enumerate(episodes)}
    scalars = np.array([[getattr(each, name) for name in SCALARS] for each in episodes], dtype=np.float64)
    return bytes(save({**arrays, "scalars": scalars}))


def _decode_episodes(data: bytes, seeds: Sequence[int]) -> list[Episode]:
    arrays = load(data)
    scalars = arrays["scalars"]
    return [
        Episode(
            seed=seed,
            observations=arrays[f"observations.{k}"],
            makespan=len(arrays[f"observations.{k}"]),
            **dict(zip(SCALARS, map(float, scalars[k]), strict=True)),
        )
        for k, seed in enumerate(seeds)
    ]
