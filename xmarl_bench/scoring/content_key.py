"""What a result depends on, as one hash: the name that it has in a store.

Policies count by architecture and weights, explainers by what they declare and by their code, the harness by
the code that a worker runs (see `source_code`) and the packages that compute. So nothing is computed again
that would be the same, and nothing is kept that would not.
"""

from __future__ import annotations

import hashlib
import sys
from functools import cache
from typing import Any

import torch

from xmarl_bench.entry.protocol import DEFINITIONS, PROTOCOL
from xmarl_bench.origin.installed import package_version
from xmarl_bench.plugins.registry import FoundExplainer
from xmarl_bench.policy import PolicyCard
from xmarl_bench.records.files import canonical_json
from xmarl_bench.scoring.source_code import source_sha256

COMPUTED_BY = (
    "xmarl_bench.scoring.measure",
    "xmarl_bench.scoring.behaviour",
    "xmarl_bench.rollout.episodes",
    "xmarl_bench.explain.fitting",
)
PACKAGES = ("numpy", "pymunk", "torch", "torch-geometric")
DECLARED = ("name", "stochastic", "control", "batched", "binary", "signed", "accesses")


def content_key(*parts: Any) -> str:
    """sha256 of a value made of JSON's types."""
    return hashlib.sha256(canonical_json([harness(), *parts])).hexdigest()


@cache
def harness() -> str:
    """Of the code and packages that compute results, and of what their names mean."""
    content = {
        "protocol": PROTOCOL,
        "definitions": DEFINITIONS,
        "code": source_sha256(*COMPUTED_BY),
        "version": package_version("xmarl-bench"),
        "python": sys.version_info[:2],
        "packages": {name: package_version(name) for name in PACKAGES},
        "cpu": torch.backends.cpu.get_cpu_capability(),  # decides how matrix products round
    }
    return hashlib.sha256(canonical_json(content)).hexdigest()


def policy_key(card: PolicyCard) -> str:
    """Of a policy's function; its name and history have no part in it."""
    content = card.architecture.model_dump(mode="json"), card.weights_sha256
    return hashlib.sha256(canonical_json(content)).hexdigest()


def explainer_key(found: FoundExplainer) -> str:
    """Of an explainer. Code that it imports counts where it is of the same package, or of ours."""
    explainer = found.explainer
    content = {
        **{name: getattr(explainer, name) for name in DECLARED},
        "hyperparameters": dict(explainer.hyperparameters),
        "fit": explainer.fit is not None,
        "origin": [found.distribution, found.version, found.entry_point],
        "code": code_sha256(found),
    }
    return hashlib.sha256(canonical_json(content)).hexdigest()


def code_sha256(found: FoundExplainer) -> str | None:
    """Of an explainer's code: the file that the command line named, or its module and what that imports."""
    return found.code_sha256 or source_sha256(found.entry_point.partition(":")[0])
