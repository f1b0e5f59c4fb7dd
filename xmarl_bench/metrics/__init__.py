"""Explanation metrics of protocol `xmarl-1`: pure functions of arrays, one file each, all in float64.

The last axes are agents N and action entries A (or receivers and senders); leading axes are kept, so a
metric of (T, N, A) arrays is (T,), one number per timestep. NaN goes in, NaN comes out.
"""

from xmarl_bench.metrics.attention_entropy import attention_entropy
from xmarl_bench.metrics.fidelity import Fidelity, fidelity, prediction_change
from xmarl_bench.metrics.mask_mass import mask_mass
from xmarl_bench.metrics.unfaithfulness import graph_explanation_unfaithfulness, kl_divergence

__all__ = [
    "Fidelity", "attention_entropy", "fidelity", "graph_explanation_unfaithfulness", "kl_divergence",
    "mask_mass", "prediction_change",
]  # fmt: skip
