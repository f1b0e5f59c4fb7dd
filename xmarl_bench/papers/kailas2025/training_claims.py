"""The statements on checkpoints along training: navigation, three agents, 20, 50 and 80 % (appendix).

The paper's text says 10, 50 and 90 %, but its figure and table say 20, 50 and 80 %, which we use.
"""

from __future__ import annotations

from xmarl_bench.papers.kailas2025.claims import (
    ATTENTION,
    FIDELITY_MARGIN,
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
    best,
    improves,
    improves_more,
    keeps,
    unmoved,
    worsens,
    worst,
)
from xmarl_bench.papers.kailas2025.paper import NAVIGATION, TRAINING

N_AGENTS = 3
CELLS = tuple(Cell(NAVIGATION, N_AGENTS, percent=percent) for percent in TRAINING)
BOTH = tuple(
    Cell(NAVIGATION, N_AGENTS, percent=percent, regularised=regularised)
    for regularised in (False, True)
    for percent in TRAINING
)
RUNS = tuple(Cell(NAVIGATION, N_AGENTS, regularised=regularised) for regularised in (False, True))

FIDELITY = "Appendix, Explanation Quality Over Training Iterations, Delta Fidelity"
FAITHFULNESS = "Appendix, Explanation Quality Over Training Iterations, Unfaithfulness"
PERFORMANCE = "Appendix, Explanation Quality Over Training Iterations, Task Performance"


training = Statements("training", CELLS)


def grows(explainer: str, metric: str) -> Contrast:
    """Better at 80 % of training than at 20 %."""
    return Contrast(metric, Side(Term(explainer, percent=80)), Side(Term(explainer, percent=20)))


def best_of_all(metric: str) -> tuple[Contrast, ...]:
    """AttentionExplainer on regularised policies above all five other combinations."""
    others = [(GNN, True), (GRAPHMASK, True), (ATTENTION, False), (GNN, False), (GRAPHMASK, False)]
    return tuple(Contrast(metric, Side(Term(ATTENTION, True)), Side(Term(*other))) for other in others)


TRAINING_CLAIMS: tuple[Claim, ...] = (
    training(
        "graphmask-unmoved", "596", FIDELITY,
        "GraphMask gains no FidDelta by the term", unmoved(GRAPHMASK, "fid_delta"),
    ),
    training(
        "graphmask-trade", "596", FIDELITY,
        "GraphMask trades Fid+ for Fid-: the term improves the one and worsens the other",
        improves(GRAPHMASK, "fid_minus"), worsens(GRAPHMASK, "fid_plus"),
    ),
    training(
        "gnn-grows", "596", FIDELITY,
        "GNNExplainer's FidDelta improves over the course of training", grows(GNN, "fid_delta"),
        cells=RUNS, quantifier=Quantifier.EVERY,
    ),
    training(
        "attention-grows", "596", FIDELITY,
        "AttentionExplainer's FidDelta improves over the course of training", grows(ATTENTION, "fid_delta"),
        cells=RUNS, quantifier=Quantifier.EVERY,
    ),
    training(
        "gnn-improves", "596", FIDELITY,
        "GNNExplainer's FidDelta benefits from the term", improves(GNN, "fid_delta"),
    ),
    training(
        "attention-improves", "433, 596", FIDELITY,
        "AttentionExplainer's FidDelta benefits from the term", improves(ATTENTION, "fid_delta"),
    ),
    training(
        "attention-improves-more", "596", FIDELITY,
        "AttentionExplainer's FidDelta gains more by the term than GNNExplainer's",
        improves_more(ATTENTION, GNN, "fid_delta"),
    ),
    training(
        "graphmask-least", "596", FIDELITY,
        "GraphMask has the least FidDelta, with the term and without", *worst(GRAPHMASK, "fid_delta"),
        cells=BOTH, quantifier=Quantifier.EVERY,
    ),
    training(
        "gnn-best-without", "596", FIDELITY,
        "Without the term GNNExplainer has the most FidDelta", *best(GNN, "fid_delta", regularised=False),
    ),
    training(
        "attention-best-with", "596", FIDELITY,
        "With the term AttentionExplainer has the most FidDelta",
        *best(ATTENTION, "fid_delta", regularised=True),
    ),
    training(
        "attention-best-overall", "596", FIDELITY,
        "AttentionExplainer with the term has the most FidDelta overall", *best_of_all("fid_delta"),
    ),
    training(
        "graphmask-gef", "433, 599", FAITHFULNESS,
        "The term improves GraphMask's GEF", improves(GRAPHMASK, "gef"),
    ),
    training(
        "attention-gef", "433, 599", FAITHFULNESS,
        "The term improves AttentionExplainer's GEF", improves(ATTENTION, "gef"),
    ),
    training(
        "gnn-gef", "433, 599", FAITHFULNESS,
        "The term improves GNNExplainer's GEF negligibly to slightly (here: does not worsen it by over 0.02)",
        keeps("gef", FIDELITY_MARGIN, GNN),
    ),
    training(
        "graphmask-least-faithful", "599", FAITHFULNESS,
        "GraphMask has the worst GEF, with the term and without", *worst(GRAPHMASK, "gef"),
        cells=BOTH, quantifier=Quantifier.EVERY,
    ),
    training(
        "gnn-most-faithful-without", "599", FAITHFULNESS,
        "Without the term GNNExplainer has the best GEF", *best(GNN, "gef", regularised=False),
    ),
    training(
        "attention-most-faithful-with", "599", FAITHFULNESS,
        "With the term AttentionExplainer has the best GEF", *best(ATTENTION, "gef", regularised=True),
    ),
    training(
        "attention-most-faithful-overall", "599", FAITHFULNESS,
        "AttentionExplainer with the term has the best GEF overall", *best_of_all("gef"),
    ),
    training(
        "success", "602, table", PERFORMANCE,
        "Success with the term ranges from comparable to better (here: at most 0.05 worse)",
        keeps("success_rate", RATE_MARGIN), quantifier=Quantifier.EVERY,
    ),
    training(
        "agent-collisions", "602, table", PERFORMANCE,
        "Freedom from collisions with the term ranges from comparable to better (here: at most 0.05 worse)",
        keeps("no_agent_collision", RATE_MARGIN), quantifier=Quantifier.EVERY,
    ),
)  # fmt: skip
