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
    "architecture": (
        "AnyArchitecture", "Architecture", "CodeArchitecture", "GraphLayer", "LayeredArchitecture",
    ),
    "build": ("build_policy", "initial_policy"),
    "bundle": ("load_policy", "save_policy"),
    "card": ("PolicyCard",),
    "distribution": ("ActionDistribution",),
    "graph": ("CompleteGraph", "FixedGraph", "Graph", "RadiusGraph", "complete_graph"),
    "interface": ("Policy", "existing_edges"),
    "module": ("ModulePolicy",),
    "network": ("GraphPolicy", "Prepared"),
}  # fmt: skip
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "ActionDistribution", "AnyArchitecture", "Architecture", "CodeArchitecture", "CompleteGraph",
    "FixedGraph", "Graph", "GraphLayer", "GraphPolicy", "LayeredArchitecture", "ModulePolicy", "Policy",
    "PolicyCard", "Prepared", "RadiusGraph", "build_policy", "complete_graph",
    "existing_edges", "initial_policy", "load_policy", "save_policy",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'xmarl_bench.policy' has no attribute {name!r}")
    value = getattr(import_module(f"xmarl_bench.policy.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value
