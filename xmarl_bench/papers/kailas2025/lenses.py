"""The same ledger with variants of the explainers and metrics that the paper does not have.

A lens replaces explainers and metrics in a statement. It omits statements that it does not change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from xmarl_bench.metrics.absence import Absence
from xmarl_bench.metrics.table import UNDER_ABSENCES
from xmarl_bench.papers.kailas2025.claims import (
    ATTENTION,
    GNN,
    GRAPHMASK,
    OF_THE_POLICY,
    RATE_MARGIN,
    VARIANTS,
    Claim,
    Contrast,
    Relation,
    Side,
    Term,
)

# Scaled to about 1, not in action units.
SHARES = ("budgeted_fidelity", *UNDER_ABSENCES, "message_fidelity", "behavioural_fidelity")


@dataclass(frozen=True)
class Lens:
    name: str
    text: str
    explainers: Mapping[str, str] = field(default_factory=dict)
    metrics: Mapping[str, str] = field(default_factory=dict)

    def apply(self, claim: Claim) -> Claim | None:
        """The statement through the lens; None if nothing changes, or if a simpler lens does the same."""
        seen = replace(claim, contrasts=tuple(self._contrast(each) for each in claim.contrasts))
        names = {
            term.explainer for each in claim.contrasts for side in (each.a, each.b) for term in side.terms
        }
        if seen == claim:
            return None
        if self.metrics and [x.metric for x in seen.contrasts] == [x.metric for x in claim.contrasts]:
            return None
        if len(self.explainers) > 1 and not self.metrics and len(names & set(self.explainers)) < 2:
            return None
        return seen

    def _contrast(self, contrast: Contrast) -> Contrast:
        if contrast.metric in OF_THE_POLICY:
            return contrast
        metric = self.metrics.get(contrast.metric, contrast.metric)
        margin = contrast.margin
        if metric in SHARES and contrast.relation is not Relation.BETTER:
            margin = RATE_MARGIN
        return replace(
            contrast, metric=metric, margin=margin, a=self._side(contrast.a), b=self._side(contrast.b)
        )

    def _side(self, side: Side) -> Side:
        return Side(self._term(side.term), None if side.minus is None else self._term(side.minus))

    def _term(self, term: Term) -> Term:
        return replace(term, explainer=self.explainers.get(term.explainer, term.explainer))


COMMUNICATION = {name: f"comm_{name}" for name in ("fid_delta", "fid_plus", "fid_minus", "gef")}
COMMUNICATION_BUDGETED = {"fid_delta": "comm_budgeted_fidelity"}

# The paper takes a message away by a zero.
BY_ABSENCE = tuple(
    Lens(
        f"absence: {absence}",
        f"communication-only budgeted fidelity under the absence model `{absence}`, in place of FidDelta",
        metrics={"fid_delta": metric},
    )
    for absence, metric in zip(Absence, UNDER_ABSENCES, strict=True)
    if absence is not Absence.ZERO
)
BEHAVIOUR = Lens(
    "behaviour",
    "behavioural fidelity in place of FidDelta: success of the team on the explanation's messages above its "
    "success on the others",
    {},
    {"fid_delta": "behavioural_fidelity"},
)
LENSES = (
    Lens("corrected GraphMask", "GraphMask after its own paper", {GRAPHMASK: VARIANTS[GRAPHMASK]}),
    Lens("tuned GNNExplainer", "GNNExplainer from zero with a larger learning rate", {GNN: VARIANTS[GNN]}),
    Lens("attention / row max", "attention divided by its row maximum", {ATTENTION: VARIANTS[ATTENTION]}),
    Lens("all three variants", "these three together", VARIANTS),
    Lens(
        "budgeted fidelity",
        "budgeted fidelity in place of FidDelta: the ranking of edges alone",
        metrics={"fid_delta": "budgeted_fidelity"},
    ),
    Lens(
        "communication-only",
        "messages between agents alone, every agent's own edge kept",
        metrics=COMMUNICATION,
    ),
    Lens(
        "communication-only budgeted",
        "communication-only budgeted fidelity in place of FidDelta: the leaderboard's order under zero alone",
        {},
        COMMUNICATION_BUDGETED,
    ),
    Lens(
        "variants by communication-only budgeted",
        "the three variants, by communication-only budgeted fidelity",
        VARIANTS,
        COMMUNICATION_BUDGETED,
    ),
    Lens(
        "message fidelity",
        "message fidelity in place of FidDelta: the leaderboard's order, over all absence models",
        metrics={"fid_delta": "message_fidelity"},
    ),
    *BY_ABSENCE,
    BEHAVIOUR,
)
