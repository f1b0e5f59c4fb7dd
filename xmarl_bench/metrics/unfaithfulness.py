"""Graph explanation unfaithfulness: how far the policy's action distribution moves under the mask.

Source: Agarwal et al. (GraphXAI, 2023), for action distributions as in Kailas et al. (ICML 2025):

    GEF = mean_i (1 - exp(-KL(F_i(1) || F_i(m)))).

The KL is per agent, summed over action entries, in this direction. PyG and GraphXAI compute the reverse KL; a
joint KL over agents saturates as the team grows. The diagonal Normals under the tanh have the same KL as the
TanhNormals, because tanh is one-to-one. For discrete actions it is the KL of the categoricals.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def kl_divergence(
    loc_p: NDArray[np.floating],
    scale_p: NDArray[np.floating],
    loc_q: NDArray[np.floating],
    scale_q: NDArray[np.floating],
) -> Floats:
    """KL(p || q) of diagonal Normals, four arrays (..., A) -> (...), in nats, summed over the last axis."""
    mean_p, std_p, mean_q, std_q = (np.asarray(x, dtype=np.float64) for x in (loc_p, scale_p, loc_q, scale_q))
    ratio = (std_p / std_q) ** 2
    shift = ((mean_p - mean_q) / std_q) ** 2
    return np.asarray((0.5 * (ratio + shift - 1.0 - np.log(ratio))).sum(axis=-1))


def categorical_kl(log_p: NDArray[np.floating], log_q: NDArray[np.floating]) -> Floats:
    """KL(p || q) of categoricals, two arrays (..., A) of log-probabilities -> (...), in nats."""
    p, q = (_normalised(np.asarray(x, dtype=np.float64)) for x in (log_p, log_q))
    return np.asarray(np.maximum((np.exp(p) * (p - q)).sum(axis=-1), 0.0))


def _normalised(log_p: Floats) -> Floats:
    """Log-probabilities of float32 sum to 1 up to its rounding: enough for a KL below 0."""
    return np.asarray(log_p - np.log(np.exp(log_p).sum(axis=-1, keepdims=True)))


def graph_explanation_unfaithfulness(kl: Floats) -> Floats:
    """KL per agent (..., N) -> GEF (...) in [0, 1]; 0 if the mask changes nothing."""
    return np.asarray((-np.expm1(-kl)).mean(axis=-1))
