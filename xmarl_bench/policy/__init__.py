"""Graph-attention policies: their architecture record, the network with its masked forward, their files.

Names are loaded on first use, so that reading records of policies does not wait for torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from xmarl_bench.policy.architecture import (
        AnyArchitecture,
        Architecture,
        CodeArchitecture,
        GraphLayer,
        LayeredArchitecture,
    )
    from xmarl_bench.policy.build import build_policy, initial_policy
    from xmarl_bench.policy.bundle import load_policy, save_policy
    from xmarl_bench.policy.card import PolicyCard
    from xmarl_bench.policy.distribution import ActionDistribution
    from xmarl_bench.policy.graph import CompleteGraph, FixedGraph, Graph, RadiusGraph, complete_graph
    from xmarl_bench.policy.interface import Policy, existing_edges
    from xmarl_bench.policy.module import ModulePolicy
    from xmarl_bench.policy.network import GraphPolicy, Prepared

_MODULES = {
    "ActionDistribution": "distribution",
    "AnyArchitecture": "architecture",
    "Architecture": "architecture",
    "CodeArchitecture": "architecture",
    "CompleteGraph": "graph",
    "FixedGraph": "graph",
    "Graph": "graph",
    "GraphLayer": "architecture",
    "GraphPolicy": "network",
    "LayeredArchitecture": "architecture",
    "ModulePolicy": "module",
    "Policy": "interface",
    "PolicyCard": "card",
    "Prepared": "network",
    "RadiusGraph": "graph",
    "build_policy": "build",
    "complete_graph": "graph",
    "existing_edges": "interface",
    "initial_policy": "build",
    "load_policy": "bundle",
    "save_policy": "bundle",
}

__all__ = [
    "ActionDistribution", "AnyArchitecture", "Architecture", "CodeArchitecture", "CompleteGraph",
    "FixedGraph", "Graph", "GraphLayer", "GraphPolicy", "LayeredArchitecture", "ModulePolicy", "Policy",
    "PolicyCard", "Prepared", "RadiusGraph", "build_policy", "complete_graph",
    "existing_edges", "initial_policy", "load_policy", "save_policy",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'xmarl_bench.policy' has no attribute {name!r}")
    value = getattr(import_module(f"xmarl_bench.policy.{_MODULES[name]}"), name)
    globals()[name] = value
    return value
