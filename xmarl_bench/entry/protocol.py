"""The definitions of an entry's numbers. Scores depend on every word here: a change needs a new protocol id.

Formulae and reasons are in docs/metrics.md.
"""

from __future__ import annotations

from typing import Final

from xmarl_bench.metrics.table import FAMILIES, METRICS
from xmarl_bench.policy.architecture import DistributionKind

PROTOCOL: Final = "xmarl-3"
# What a whole score covers; less is valid, but not ranked.
EPISODES: Final = 50
LARGER_TEAM: Final = 6  # from this size on, larger than any team of the suite, some timesteps suffice
LARGER_TIMESTEPS: Final = 40
# States of the sanity checks: the first episodes of a run, at evenly spaced timesteps.
SANITY_EPISODES: Final = 5
SANITY_TIMESTEPS: Final = 20
# Episodes, of those played on an explanation, that are also played under absence models other than zero.
ABSENCE_EPISODES: Final = 10

# Definitions for cells with a sampled oracle, which share no table with others.
SAMPLED: Final = (
    "random@k: estimate by random orders of the senders of each row, in pairs of an order and its "
    "reverse: mean FidDelta of the masks of the k first of every row. oracle@k: estimate from below, the "
    "best mask of k edges from every row among these, the k highest of attention, greedy chains up and "
    "down and, where rows do not act alone, two sweeps of swaps row by row; at least FidDelta@k of the "
    "mask that is scored. FidDelta@k of a mask with equal values: mean over the same orders"
)

DEFINITIONS: dict[str, str] = {
    "F(m)": "action tanh(loc) in [-1, 1] with the message on edge j -> i scaled by m[i, j] after the "
    "softmax, nothing renormalised",
    **{metric.name: metric.definition for metric in METRICS if metric.definition is not None},
    **FAMILIES,
    "absence models": "what stands in for a message that is taken away, coefficients as they were. zero: "
    "nothing. mean: the mean message of its sender over reference states. resample: the same sender's "
    "message in a reference state drawn at random, 4 draws for each timestep, their effects averaged. "
    "renormalised: nothing, and the kept coefficients sum to 1 again. Where none is named: zero",
    "reference states": "20 evenly spaced timesteps of each of 10 episodes, environment seeds 2^30 + k",
    "rank correlation": "Spearman's, of senders within each row, pooled over rows and timesteps; on the "
    "first 5 episodes and at most 20 timesteps of each",
    "controls": "other masks on the same policy and states: all-ones, zeros, random (uniform), bernoulli "
    "(0.5), self (own edges), inverted (1 - m), oracle (the best binary mask for fid_delta), soft-oracle "
    "(projected ascent from it)",
    "aggregation": "mean over timesteps within an episode, then mean over episodes; percentile bootstrap "
    "interval (95 %) over episodes; what is not a number is left out and counted in n_nan",
    "timesteps": "null: all T of an episode; K: at most K, number floor((2 k + 1) T / (2 K)), k = 0 .. K - 1",
    "seeds": "environment seed of each episode: 10^12 + seed * 10^6 + k",
}

# Definitions that differ if actions are discrete (`continuous_actions=False`).
OF_CATEGORICALS: Final[dict[str, str]] = {
    "F(m)": "probabilities of the discrete actions, of which the likeliest is played, with the message on "
    "edge j -> i scaled by m[i, j] after the softmax, nothing renormalised",
    **{metric.name: metric.of_categoricals for metric in METRICS if metric.of_categoricals is not None},
}

# Definitions that differ if actions are Normals without a tanh (stable-baselines3, some of BenchMARL).
OF_NORMALS: Final[dict[str, str]] = {
    "F(m)": "action loc, clipped to [-1, 1], with the message on edge j -> i scaled by m[i, j] after the "
    "softmax, nothing renormalised",
    **{
        metric.name: metric.definition.replace(" under the tanh", "")
        for metric in METRICS
        if metric.definition is not None and " under the tanh" in metric.definition
    },
}

_OTHER_DEFINITIONS: Final = {"categorical": OF_CATEGORICALS, "normal": OF_NORMALS}


def definitions(distribution: DistributionKind) -> dict[str, str]:
    """The definitions of the numbers of an entry, for its policy's distribution of actions."""
    return DEFINITIONS | _OTHER_DEFINITIONS.get(distribution, {})
