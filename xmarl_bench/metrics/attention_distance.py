"""D(alpha): the distance between the subgraph that attention induces and its complement, of a policy.

Source: Kailas et al. (ICML 2025), section "Theoretical Analysis": the entry-wise 1-norm of the difference of
the two adjacency matrices,

    D(alpha) = sum_ij |alpha_ij - (1 - alpha_ij)| = sum_ij |2 alpha_ij - 1|  in [|2 N - N^2|, N^2].

Uniform attention attains the lower bound, one sender per receiver the upper one. For N >= 3, every alpha
without an entry above 1/2 attains the lower bound too, because rows sum to 1 and so

    D(alpha) = N^2 - 2 N + 4 sum_i max(0, max_j alpha_ij - 1/2).

D depends only on how far each receiver's largest coefficient exceeds one half.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.metrics.attention_entropy import are_shares


def attention_distance(
    attention: NDArray[np.floating], edges: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """(..., N, N) attention -> (...) D(alpha); NaN where rows do not sum to 1.

    edges: (..., N, N), the edges of the graph, None for all: other edges are in neither graph compared.
    """
    difference = np.abs(2.0 * attention.astype(np.float64) - 1.0)
    distance = (difference if edges is None else difference * edges).sum(axis=(-2, -1))
    return np.where(are_shares(attention), distance, np.nan)
