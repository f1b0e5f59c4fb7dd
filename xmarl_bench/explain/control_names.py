"""Names of controls and of communication-only explainers. Imports no torch; `controls` makes the masks."""

from __future__ import annotations

from typing import Final

RANDOM: Final = "random"
INVERTED: Final = "inverted"
ORACLE: Final = "oracle"
SOFT_ORACLE: Final = "soft-oracle"
NEAREST: Final = "nearest"
INITIAL_ATTENTION: Final = "initial-attention"
MESSAGES_ONLY: Final = "-messages"  # ends the name of an explainer that keeps every agent's own edge

# Of every control that needs nothing but a policy and states, in the order of lists and entries.
SUMMARIES: Final = {
    "all-ones": "keeps every edge: shows that a high FidDelta alone proves nothing",
    "zeros": "keeps nothing",
    RANDOM: "uniform random mask",
    "bernoulli": "random edges, half of them",
    "self": "each agent's own edge only: explains no coordination",
    ORACLE: "the best binary mask for FidDelta",
    SOFT_ORACLE: "the best mask found by ascent from the oracle",
}
STOCHASTIC: Final = (RANDOM, "bernoulli")
BY_ZERO: Final = (ORACLE, SOFT_ORACLE)  # they remove messages by the absence model `zero`
