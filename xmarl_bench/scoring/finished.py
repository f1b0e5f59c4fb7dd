"""Results of pieces as bytes in a store, and back.

Episodes are safetensors, everything else is JSON, whose numbers come back to the bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load, save

from xmarl_bench.errors import InputError
from xmarl_bench.rollout.episodes import Episode
from xmarl_bench.scoring.behaviour import Played
from xmarl_bench.scoring.measure import Explained, Shared
from xmarl_bench.scoring.pieces import Piece
from xmarl_bench.scoring.store import Store

Kind = TypeVar("Kind")
Result = list[Episode] | list[Shared] | list[Explained] | Played
SCALARS = ("reward", "success_rate", "no_agent_collision", "no_object_collision")
SHARED, EXPLAINED, PLAYED = TypeAdapter(list[Shared]), TypeAdapter(list[Explained]), TypeAdapter(Played)


def encode(result: Result) -> bytes:
    if isinstance(result, Played):
        return PLAYED.dump_json(result)
    if all(isinstance(each, Shared) for each in result):
        return SHARED.dump_json(result)  # type: ignore[arg-type]
    if all(isinstance(each, Explained) for each in result):
        return EXPLAINED.dump_json(result)  # type: ignore[arg-type]
    return _encode_episodes(result)  # type: ignore[arg-type]


class Finished:
    """The results of pieces that a store holds. To read one that it lacks raises InputError."""

    def __init__(self, store: Store) -> None:
        self.store = store

    def has(self, piece: Piece) -> bool:
        return self.store.has(piece.key)

    def episodes(self, piece: Piece) -> list[Episode]:
        data = self._read(piece)
        try:
            return _decode_episodes(data, piece.block.seeds)
        except (SafetensorError, KeyError, ValueError):
            raise self._gone(piece) from None

    def shared(self, piece: Piece) -> list[Shared]:
        return self._decoded(piece, SHARED)

    def explained(self, piece: Piece) -> list[Explained]:
        return self._decoded(piece, EXPLAINED)

    def played(self, piece: Piece) -> Played:
        return self._decoded(piece, PLAYED)

    def _decoded(self, piece: Piece, adapter: TypeAdapter[Kind]) -> Kind:
        try:
            return adapter.validate_json(self._read(piece))
        except ValidationError:
            raise self._gone(piece) from None

    def _read(self, piece: Piece) -> bytes:
        data = self.store.read(piece.key)
        if data is None:
            raise self._gone(piece)
        return data

    def _gone(self, piece: Piece) -> InputError:
        return InputError(
            f"{self.store.path(piece.key)} ({piece}) is gone or was changed: run the same command again, "
            f"which computes what is missing."
        )


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
