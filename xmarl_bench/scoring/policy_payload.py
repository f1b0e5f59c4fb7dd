"""Work for a worker, pickled with its policy apart, so that a worker loads each policy only once."""

from __future__ import annotations

import io
import pickle
from functools import lru_cache
from typing import Any, Generic, TypeVar

import cloudpickle

from xmarl_bench.origin.pickling import dumps
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
        policy, rest = self._policy, io.BytesIO()

        class Pickler(cloudpickle.Pickler):  # type: ignore[misc]
            def persistent_id(self, obj: object) -> str | None:
                return "policy" if obj is policy else None

        Pickler(rest).dump(self.work)
        return _arrived, (dumps(policy), rest.getvalue())


def _arrived(pickled: bytes, rest: bytes) -> PolicyPayload[Any]:
    policy = _loaded(pickled)

    class Unpickler(pickle.Unpickler):
        def persistent_load(self, pid: object) -> Policy:
            return policy

    return PolicyPayload(Unpickler(io.BytesIO(rest)).load(), policy)


@lru_cache(maxsize=POLICIES_KEPT)
def _loaded(pickled: bytes) -> Policy:
    policy: Policy = pickle.loads(pickled)
    return policy
