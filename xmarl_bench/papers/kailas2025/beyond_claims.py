"""Our own statements, on questions that the paper leaves open. Same cells and rules as the main study."""

from __future__ import annotations

from xmarl_bench.explain.control_names import ORACLE
from xmarl_bench.papers.kailas2025.claims import (
    ATTENTION,
    GNN,
    GRAPHMASK,
    RATE_MARGIN,
    VARIANTS,
    Claim,
    Contrast,
    Quantifier,
    Relation,
    Side,
    Statements,
    Term,
    beats,
)
from xmarl_bench.papers.kailas2025.main_claims import CELLS

ALL_ONES = "all-ones"
PLACE = "none: ours"


beyond = Statements("beyond", CELLS)

BEYOND_CLAIMS: tuple[Claim, ...] = (
    beyond(
        "hard-masks-suffice", "-", PLACE,
        "Hardness is no limit (against line 331): the best binary mask has more FidDelta than the soft masks "
        "of AttentionExplainer and GNNExplainer",
        beats(ORACLE, ATTENTION, "fid_delta"), beats(ORACLE, GNN, "fid_delta"),
        quantifier=Quantifier.TOGETHER,
    ),
    beyond(
        "all-ones", "-", PLACE,
        "FidDelta can be gamed: the mask of ones, which explains nothing, has more of it than all three",
        *(beats(ALL_ONES, each, "fid_delta") for each in (ATTENTION, GNN, GRAPHMASK)),
        quantifier=Quantifier.TOGETHER,
    ),
    beyond(
        "graphmask-corrected", "-", PLACE,
        "GraphMask after its own paper has more FidDelta than torch_geometric's",
        beats(VARIANTS[GRAPHMASK], GRAPHMASK, "fid_delta"),
    ),
    beyond(
        "graphmask-corrected-ranks", "-", PLACE,
        "GraphMask after its own paper ranks messages better than torch_geometric's",
        beats(VARIANTS[GRAPHMASK], GRAPHMASK, "comm_budgeted_fidelity"),
    ),
    beyond(
        "gnn-tuned", "-", PLACE,
        "Tuned GNNExplainer has more FidDelta than with its defaults",
        beats(VARIANTS[GNN], GNN, "fid_delta"),
    ),
    beyond(
        "gnn-tuned-ranks", "-", PLACE,
        "Tuned GNNExplainer ranks messages better than with its defaults",
        beats(VARIANTS[GNN], GNN, "comm_budgeted_fidelity"),
    ),
    beyond(
        "mask-mass", "-", PLACE,
        "Mask mass alone moves FidDelta: attention divided by its row maximum has more of it than attention",
        beats(VARIANTS[ATTENTION], ATTENTION, "fid_delta"),
    ),
    beyond(
        "mask-mass-ranks", "-", PLACE,
        "... and ranks messages as attention does (communication-only budgeted fidelity within 0.05)",
        Contrast(
            "comm_budgeted_fidelity", Side(Term(VARIANTS[ATTENTION])), Side(Term(ATTENTION)), Relation.SAME,
            RATE_MARGIN,
        ),
    ),
    beyond(
        "attention-ranks-best", "-", PLACE,
        "AttentionExplainer ranks messages better than tuned GNNExplainer and corrected GraphMask",
        beats(ATTENTION, VARIANTS[GNN], "comm_budgeted_fidelity"),
        beats(ATTENTION, VARIANTS[GRAPHMASK], "comm_budgeted_fidelity"),
    ),
)  # fmt: skip
