"""The statements on larger teams: navigation with one, two and three agents more than in training."""

from __future__ import annotations

from xmarl_bench.papers.kailas2025.claims import (
    ATTENTION,
    GNN,
    GRAPHMASK,
    RATE_MARGIN,
    Cell,
    Claim,
    Contrast,
    Quantifier,
    Side,
    Statements,
    Term,
    beats,
    best,
    improves,
    improves_more,
    keeps,
    unmoved,
    worsens,
    worst,
)
from xmarl_bench.papers.kailas2025.paper import NAVIGATION, ZERO_SHOT

CELLS = tuple(Cell(NAVIGATION, n_trained, more=n_tested - n_trained) for n_trained, n_tested in ZERO_SHOT)
NEAREST = tuple(cell for cell in CELLS if cell.more == 1)
SIZES = tuple(Cell(NAVIGATION, n_trained, more=None) for n_trained in (3, 4, 5))

FIDELITY = "Appendix, Zero-Shot Deployment for Larger Team Sizes, Delta Fidelity"
FAITHFULNESS = "Appendix, Zero-Shot Deployment for Larger Team Sizes, Unfaithfulness"
PERFORMANCE = "Appendix, Zero-Shot Deployment for Larger Team Sizes, Task Performance"


zero_shot = Statements("zero-shot", CELLS)


def lead_shrinks(metric: str) -> Contrast:
    """AttentionExplainer's lead over GNNExplainer is larger with one agent more than with three."""
    near, far = (Side(Term(ATTENTION, True, more=more), Term(GNN, True, more=more)) for more in (1, 3))
    return Contrast(metric, near, far)


def effect_fades(metric: str) -> Contrast:
    """What the term does to a metric of the policy is more with one agent more than with three."""
    near, far = (Side(Term(ATTENTION, True, more=more), Term(ATTENTION, False, more=more)) for more in (1, 3))
    return Contrast(metric, near, far)


ZERO_SHOT_CLAIMS: tuple[Claim, ...] = (
    zero_shot(
        "graphmask-unmoved", "645", FIDELITY,
        "GraphMask gains no FidDelta by the term", unmoved(GRAPHMASK, "fid_delta"),
    ),
    zero_shot(
        "graphmask-trade", "645", FIDELITY,
        "GraphMask trades Fid+ for Fid-: the term improves the one and worsens the other",
        improves(GRAPHMASK, "fid_minus"), worsens(GRAPHMASK, "fid_plus"),
    ),
    zero_shot(
        "gnn-improves", "645", FIDELITY,
        "GNNExplainer's FidDelta benefits from the term", improves(GNN, "fid_delta"),
    ),
    zero_shot(
        "attention-improves", "433, 645", FIDELITY,
        "AttentionExplainer's FidDelta benefits from the term", improves(ATTENTION, "fid_delta"),
    ),
    zero_shot(
        "attention-improves-more", "645", FIDELITY,
        "AttentionExplainer's FidDelta gains more by the term than GNNExplainer's",
        improves_more(ATTENTION, GNN, "fid_delta"),
    ),
    zero_shot(
        "fid-delta-lead-shrinks", "645", FIDELITY,
        "With the term, AttentionExplainer's lead over GNNExplainer in FidDelta shrinks from one agent more "
        "to three", lead_shrinks("fid_delta"), cells=SIZES,
    ),
    zero_shot(
        "entropy-transfers", "645", FIDELITY,
        "Policies trained with the term have lower attention entropy in larger teams too",
        improves(ATTENTION, "attention_entropy"),
    ),
    zero_shot(
        "entropy-fades", "645, 648", FIDELITY,
        "... by less the larger the team: less with three agents more than with one",
        effect_fades("attention_entropy"), cells=SIZES,
    ),
    zero_shot(
        "gnn-best-without", "645", FIDELITY,
        "Without the term GNNExplainer has the most FidDelta",
        *best(GNN, "fid_delta", regularised=False),
    ),
    zero_shot(
        "interchangeable-with", "645", FIDELITY,
        "With the term AttentionExplainer and GNNExplainer are interchangeably the best in FidDelta",
        beats(ATTENTION, GNN, "fid_delta", regularised=True), quantifier=Quantifier.MIXED,
    ),
    zero_shot(
        "graphmask-gef", "433, 648", FAITHFULNESS,
        "The term improves GraphMask's GEF", improves(GRAPHMASK, "gef"),
    ),
    zero_shot(
        "graphmask-least-faithful", "648", FAITHFULNESS,
        "With the term GraphMask's GEF stays, on average, worse than that of the other two",
        *worst(GRAPHMASK, "gef", regularised=True),
    ),
    zero_shot(
        "attention-gef", "433, 648", FAITHFULNESS,
        "The term improves AttentionExplainer's GEF", improves(ATTENTION, "gef"),
    ),
    zero_shot(
        "gnn-gef-mixed", "433, 648", FAITHFULNESS,
        "The term has mixed results for GNNExplainer's GEF", improves(GNN, "gef"),
        quantifier=Quantifier.MIXED,
    ),
    zero_shot(
        "gnn-most-faithful-without", "648", FAITHFULNESS,
        "Without the term GNNExplainer has the best GEF",
        *best(GNN, "gef", regularised=False),
    ),
    zero_shot(
        "attention-near", "648", FAITHFULNESS,
        "With the term AttentionExplainer's GEF is better than GNNExplainer's where the team is one larger",
        beats(ATTENTION, GNN, "gef", regularised=True), cells=NEAREST,
    ),
    zero_shot(
        "gef-lead-shrinks", "645, 648", FAITHFULNESS,
        "With the term, AttentionExplainer's lead over GNNExplainer in GEF shrinks from one agent more to "
        "three", lead_shrinks("gef"), cells=SIZES,
    ),
    zero_shot(
        "success", "651, table", PERFORMANCE,
        "Success with the term ranges from comparable to better (here: at most 0.05 worse)",
        keeps("success_rate", RATE_MARGIN), quantifier=Quantifier.EVERY,
    ),
    zero_shot(
        "agent-collisions", "651, table", PERFORMANCE,
        "Freedom from collisions with the term ranges from comparable to better (here: at most 0.05 worse)",
        keeps("no_agent_collision", RATE_MARGIN), quantifier=Quantifier.EVERY,
    ),
)  # fmt: skip
