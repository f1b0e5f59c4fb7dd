"""Work on its way to a worker, which loads each policy once, however many pieces of its work it is handed."""

from __future__ import annotations

import io
import pickle
from functools import lru_cache
from typing import Any, Generic, TypeVar

import cloudpickle

from xmarl_bench.policy import Policy

Load = TypeVar("Load")
POLICIES_KEPT = 2  # by a worker: pieces of one policy follow one another


class Carried(Generic[Load]):
    """`load` as it is in this process; pickled, its policy travels apart from the rest.

    Policies are told apart by their bytes: one whose weights have changed in the meantime is another one.
    """

    def __init__(self, load: Load, policy: Policy) -> None:
        self.load = load
        self._policy = policy

    def __reduce__(self) -> tuple[Any, ...]:
        rest = io.BytesIO()
        _Pickler(rest, self._policy).dump(self.load)
        return _arrived, (bytes(cloudpickle.dumps(self._policy)), rest.getvalue())


def _arrived(policy: bytes, rest: bytes) -> Carried[Any]:
    network = _loaded(policy)
    return Carried(_Unpickler(io.BytesIO(rest), network).load(), network)


@lru_cache(maxsize=POLICIES_KEPT)
def _loaded(policy: bytes) -> Policy:
    network: Policy = pickle.loads(policy)
    return network


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]
    """Leaves the policy out."""

    def __init__(self, file: io.BytesIO, policy: Policy) -> None:
        super().__init__(file)
        self._policy = policy

    def persistent_id(self, obj: object) -> str | None:
        return "policy" if obj is self._policy else None


class _Unpickler(pickle.Unpickler):
    """Puts the policy in its place again."""

    def __init__(self, file: io.BytesIO, policy: Policy) -> None:
        super().__init__(file)
        self._policy = policy

    def persistent_load(self, pid: object) -> Policy:
        return self._policy
