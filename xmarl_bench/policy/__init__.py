"""Graph-attention policies: their architecture record, the network with its masked forward, their files."""

from xmarl_bench.policy.architecture import Architecture
from xmarl_bench.policy.bundle import PolicyCard, load_policy, save_policy
from xmarl_bench.policy.interface import ActionDistribution, Policy
from xmarl_bench.policy.module import ModulePolicy
from xmarl_bench.policy.network import GraphPolicy, Prepared, complete_graph

__all__ = [
    "ActionDistribution", "Architecture", "GraphPolicy", "ModulePolicy", "Policy", "PolicyCard", "Prepared",
    "complete_graph", "load_policy", "save_policy",
]  # fmt: skip
