"""Graph-attention policies: their architecture record, the network with its masked forward, their files."""

from xmarl_bench.policy.architecture import (
    AnyArchitecture,
    Architecture,
    CodeArchitecture,
    GraphLayer,
    LayeredArchitecture,
)
from xmarl_bench.policy.build import build_policy
from xmarl_bench.policy.bundle import PolicyCard, load_policy, save_policy
from xmarl_bench.policy.distribution import ActionDistribution
from xmarl_bench.policy.graph import CompleteGraph, FixedGraph, Graph, RadiusGraph, complete_graph
from xmarl_bench.policy.interface import Policy, existing_edges
from xmarl_bench.policy.module import ModulePolicy
from xmarl_bench.policy.network import GraphPolicy, Prepared

__all__ = [
    "ActionDistribution", "AnyArchitecture", "Architecture", "CodeArchitecture", "CompleteGraph",
    "FixedGraph", "Graph", "GraphLayer", "GraphPolicy", "LayeredArchitecture", "ModulePolicy", "Policy",
    "PolicyCard", "Prepared", "RadiusGraph", "build_policy", "complete_graph",
    "existing_edges", "load_policy",
    "save_policy",
]  # fmt: skip
