"""Explanation metrics: pure functions of arrays, one file each, all in float64.

The last axes are agents N and action entries A (or receivers and senders); leading axes are kept, so a
metric of (T, N, A) arrays is (T,), one number per timestep, unless its docstring says that it pools them.
NaN in the input gives NaN in the result. Formulae and their meaning: docs/metrics.md.
"""

from xmarl_bench.metrics.attention_distance import attention_distance
from xmarl_bench.metrics.attention_entropy import attention_entropy
from xmarl_bench.metrics.budgeted_fidelity import (
    budgeted_fidelity,
    choices,
    fid_delta_at_k,
    fid_delta_table,
    oracle_at_k,
    other_senders,
    others_table,
    over_absences,
    random_at_k,
    rows_within,
)
from xmarl_bench.metrics.fidelity import Fidelity, fidelity, prediction_change
from xmarl_bench.metrics.mask_mass import mask_mass
from xmarl_bench.metrics.rank_correlation import rank_correlation
from xmarl_bench.metrics.unfaithfulness import categorical_kl, graph_explanation_unfaithfulness, kl_divergence

__all__ = [
    "Fidelity", "attention_distance", "attention_entropy", "budgeted_fidelity", "categorical_kl", "choices",
    "fid_delta_at_k", "fid_delta_table", "fidelity", "graph_explanation_unfaithfulness", "kl_divergence",
    "mask_mass", "oracle_at_k", "other_senders", "others_table", "over_absences",
    "prediction_change", "random_at_k", "rank_correlation", "rows_within",
]  # fmt: skip
