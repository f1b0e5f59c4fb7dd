"""The key of a piece in the cache: a hash of everything that its result depends on.

A policy counts by its architecture and weights, a task of others by its origin, code by its `code_hash`, the
harness by all of its sources, the packages that compute and the processor's vector instructions. Files that
the user's code reads are not covered. An object without a hash gets a new key each time, so that its pieces
are computed again.
"""

from __future__ import annotations

import hashlib
import secrets
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import torch

from xmarl_bench.explain.adapters import origin_of_explainer
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.origin.code_hash import harness_sources, object_sha256, sources_sha256
from xmarl_bench.origin.installed import package_version
from xmarl_bench.policy import CodeArchitecture, Policy, PolicyCard
from xmarl_bench.policy.elsewhere import PolicyElsewhere
from xmarl_bench.records.files import canonical_json
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.scoring.cache import VERSION_DIGITS
from xmarl_bench.scoring.task_record import task_record

PACKAGES = ("captum", "numpy", "pymunk", "torch", "torch-geometric")


@cache
def version_key() -> str:
    """The beginning of the keys of this version of the harness on this type of processor."""
    content = {
        "sources": sources_sha256(harness_sources()),
        "python": sys.version_info[:2],
        "packages": {name: package_version(name) for name in PACKAGES},
        "cpu": torch.backends.cpu.get_cpu_capability(),  # rounding of matrix products depends on it
    }
    return _sha256(content)[:VERSION_DIGITS]


def piece_key(*parts: Any) -> str:
    """64 hexadecimal digits for parts made of JSON's types."""
    return version_key() + _sha256(parts)[VERSION_DIGITS:]


@dataclass
class Keys:
    """Keys of policies, explainers and tasks, each computed once in a run."""

    _known: dict[int, tuple[object, str]] = field(default_factory=dict)  # by id of the object in the value

    def policy(self, policy: Policy, card: PolicyCard) -> str:
        """Key of a policy's function, independent of its name and training record."""
        return self._once(policy, lambda: _policy_key(policy, card))

    def explainer(self, explainer: Explainer) -> str:
        return self._once(explainer, lambda: _explainer_key(explainer))

    def task(self, cell: Cell) -> str | None:
        """Key of a task's code and origin; None for a task of xmarl_envs, which is of the harness."""
        record = task_record(cell)
        if record is None:
            return None
        source = cell.source
        code = self._once(source, lambda: source.code_sha256() or secrets.token_hex())
        return _sha256([record.model_dump(mode="json"), code])

    def _once(self, thing: object, key: Callable[[], str]) -> str:
        if id(thing) not in self._known:
            self._known[id(thing)] = thing, key()
        return self._known[id(thing)][1]


def _policy_key(policy: Policy, card: PolicyCard) -> str:
    code = _code_key(policy) if isinstance(card.architecture, CodeArchitecture) else None
    if isinstance(policy, PolicyElsewhere):  # shares no key with one that runs in the harness's process
        code = f"elsewhere {policy.key}"
    return _sha256([card.architecture.model_dump(mode="json"), card.weights_sha256, code])


def _explainer_key(explainer: Explainer) -> str:
    """Key of an explainer's declarations, origin and code, independent of its summary.

    One in a process of its own shares no key with those that run in the harness's.
    """
    origin, elsewhere = origin_of_explainer(explainer), explainer.elsewhere
    if elsewhere is None:
        code = _code_key(replace(explainer, summary="", origin=None))
    else:
        code = f"elsewhere {elsewhere.key} on {explainer.device}"
    return _sha256([origin.distribution, origin.version, origin.entry_point, origin.code_sha256, code])


def _code_key(thing: object) -> str:
    return object_sha256(thing) or secrets.token_hex()


def _sha256(value: Any) -> str:
    return hashlib.sha256(canonical_json(value)).hexdigest()
