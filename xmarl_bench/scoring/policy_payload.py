"""Work for a worker, pickled with its policy apart, so that a worker loads each policy only once."""

from __future__ import annotations

import io
import pickle
from functools import lru_cache
from typing import Any, Generic, TypeVar

import cloudpickle

from xmarl_bench.policy import Policy

Work = TypeVar("Work")
POLICIES_KEPT = 2  # by a worker: pieces of one policy come one after another


class PolicyPayload(Generic[Work]):
    """Holds `work`; pickling it separates the policy from the rest.

    Policies are identified by their bytes: one whose weights have changed is another policy.
    """

    def __init__(self, work: Work, policy: Policy) -> None:
        self.work = work
        self._policy = policy

    def __reduce__(self) -> tuple[Any, ...]:
        rest = io.BytesIO()
        _Pickler(rest, self._policy).dump(self.work)
        return _arrived, (bytes(cloudpickle.dumps(self._policy)), rest.getvalue())


def _arrived(policy: bytes, rest: bytes) -> PolicyPayload[Any]:
    network = _loaded(policy)
    return PolicyPayload(_Unpickler(io.BytesIO(rest), network).load(), network)


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
    """Puts the policy back in its place."""

    def __init__(self, file: io.BytesIO, policy: Policy) -> None:
        super().__init__(file)
        self._policy = policy

    def persistent_load(self, pid: object) -> Policy:
        return self._policy
