"""The statements of the main study: three tasks, three team sizes, without and with the term.

Numbers of lines are those of the authors' paper.tex.
"""

from __future__ import annotations

from xmarl_bench.papers.kailas2025.claims import (
    ATTENTION,
    GNN,
    GRAPHMASK,
    RATE_MARGIN,
    Cell,
    Claim,
    Combine,
    Contrast,
    Quantifier,
    Statements,
    beats,
    best,
    improves,
    keeps,
    unmoved,
    worsens,
    worst,
)
from xmarl_bench.papers.kailas2025.paper import MAIN, PASSAGE

CELLS = tuple(Cell(task, n_agents) for task, n_agents in MAIN)
PASSAGE_CELLS = tuple(cell for cell in CELLS if cell.task == PASSAGE)
MAKESPAN_MARGIN = 20.0  # steps, 5 % of navigation's 400

INTRODUCTION = "1 Introduction"
THEORY = "5.1 Theoretical Analysis"
FIDELITY = "6.1 Results on Explanation Fidelity"
FAITHFULNESS = "6.2 Results on Explanation Faithfulness"
PERFORMANCE = "6.3 Impact on Task Performance"
APPENDIX = "Appendix, Positive Fidelity and Negative Fidelity"

main = Statements("main", CELLS)


def improvements(explainer: str) -> tuple[Contrast, ...]:
    return tuple(improves(explainer, metric) for metric in ("fid_delta", "fid_plus", "fid_minus", "gef"))


MAIN_CLAIMS: tuple[Claim, ...] = (
    main(
        "best-with", "75, 112", INTRODUCTION,
        "The term makes AttentionExplainer the best of the three, in FidDelta and GEF, across all tasks",
        *(
            beats(ATTENTION, other, metric, regularised=True)
            for other in (GNN, GRAPHMASK)
            for metric in ("fid_delta", "gef")
        ),
        quantifier=Quantifier.EVERY,
    ),
    main(
        "gnn-one-aspect", "113", INTRODUCTION,
        "The term tends to improve at least one of the four metrics of GNNExplainer",
        *improvements(GNN), combine=Combine.ANY,
    ),
    main(
        "graphmask-one-aspect", "113", INTRODUCTION,
        "The term tends to improve at least one of the four metrics of GraphMask",
        *improvements(GRAPHMASK), combine=Combine.ANY,
    ),
    main(
        "entropy", "220-228", "5 Improving Explanations",
        "Training with the term lowers attention entropy",
        improves(ATTENTION, "attention_entropy"), quantifier=Quantifier.EVERY,
    ),
    main(
        "distance", "285", THEORY,
        "Minimising attention entropy widens D(alpha), the distance of the subgraph from its complement",
        improves(ATTENTION, "attention_distance"), quantifier=Quantifier.EVERY,
    ),
    main(
        "distance-fid-minus", "289, 296", THEORY,
        "A wider D(alpha) improves AttentionExplainer's Fid-, as empirical results support",
        improves(ATTENTION, "fid_minus"),
    ),
    main(
        "distance-fid-plus", "291, 297", THEORY,
        "A wider D(alpha) improves AttentionExplainer's Fid+, as empirical results support",
        improves(ATTENTION, "fid_plus"),
    ),
    main(
        "graphmask-least", "331", FIDELITY,
        "Without the term GraphMask tends to have the least FidDelta",
        *worst(GRAPHMASK, "fid_delta", regularised=False),
    ),
    main(
        "graphmask-under-attention", "331, 333", FIDELITY,
        "Without the term AttentionExplainer has more FidDelta than GraphMask",
        beats(ATTENTION, GRAPHMASK, "fid_delta", regularised=False),
    ),
    main(
        "attention-under-gnn", "331, 333", FIDELITY,
        "Without the term GNNExplainer has more FidDelta than AttentionExplainer",
        beats(GNN, ATTENTION, "fid_delta", regularised=False),
    ),
    main(
        "gnn-best", "335", FIDELITY,
        "GNNExplainer has the best FidDelta out of the box",
        *best(GNN, "fid_delta", regularised=False),
    ),
    main(
        "graphmask-unmoved", "337", FIDELITY,
        "The term has no discernible impact on GraphMask's FidDelta",
        unmoved(GRAPHMASK, "fid_delta"),
    ),
    main(
        "graphmask-worst-with", "337", FIDELITY,
        "With the term GraphMask still tends to have the worst FidDelta: the others continue to do better",
        *worst(GRAPHMASK, "fid_delta", regularised=True),
    ),
    main(
        "graphmask-fid-minus", "337, 558", FIDELITY + "; " + APPENDIX,
        "The term tends to improve GraphMask's Fid-",
        improves(GRAPHMASK, "fid_minus"),
    ),
    main(
        "graphmask-fid-plus", "337, 558", FIDELITY + "; " + APPENDIX,
        "The term worsens GraphMask's Fid+",
        worsens(GRAPHMASK, "fid_plus"),
    ),
    main(
        "attention-over-gnn-with", "339", FIDELITY,
        "With the term AttentionExplainer has more FidDelta than GNNExplainer",
        beats(ATTENTION, GNN, "fid_delta", regularised=True),
    ),
    main(
        "attention-correlates", "340", FIDELITY,
        "The term boosts the correlation between attention and the model's behaviour (here: the ranking of "
        "edges by attention, as budgeted fidelity)",
        improves(ATTENTION, "budgeted_fidelity"),
    ),
    main(
        "gnn-mixed", "341, 558", FIDELITY + "; " + APPENDIX,
        "The term has mixed results for GNNExplainer's FidDelta",
        improves(GNN, "fid_delta"), quantifier=Quantifier.MIXED,
    ),
    main(
        "graphmask-least-faithful", "421", FAITHFULNESS,
        "Without the term GraphMask tends to have the worst GEF",
        *worst(GRAPHMASK, "gef", regularised=False),
    ),
    main(
        "gef-split", "421", FAITHFULNESS,
        "Without the term AttentionExplainer has the better GEF in five of nine cells, GNNExplainer in four",
        beats(ATTENTION, GNN, "gef", regularised=False), quantifier=Quantifier.MIXED,
    ),
    main(
        "graphmask-gef", "426", FAITHFULNESS,
        "The term consistently improves GraphMask's GEF",
        improves(GRAPHMASK, "gef"), quantifier=Quantifier.EVERY,
    ),
    main(
        "graphmask-least-faithful-with", "426", FAITHFULNESS,
        "With the term GraphMask's GEF continues to be worse than that of the other two",
        *worst(GRAPHMASK, "gef", regularised=True),
        quantifier=Quantifier.EVERY,
    ),
    main(
        "attention-gef", "426", FAITHFULNESS,
        "The term improves AttentionExplainer's GEF across all team sizes and tasks",
        improves(ATTENTION, "gef"), quantifier=Quantifier.EVERY,
    ),
    main(
        "attention-more-faithful-with", "426", FAITHFULNESS,
        "With the term AttentionExplainer's GEF is consistently better than GNNExplainer's",
        beats(ATTENTION, GNN, "gef", regularised=True), quantifier=Quantifier.EVERY,
    ),
    main(
        "gnn-gef-mixed", "426", FAITHFULNESS,
        "The term has a mixed impact on GNNExplainer's GEF",
        improves(GNN, "gef"), quantifier=Quantifier.MIXED,
    ),
    main(
        "success", "75, 114, 430, table", PERFORMANCE,
        "The term costs little to no success (here: at most 0.05)",
        keeps("success_rate", RATE_MARGIN), quantifier=Quantifier.MOST,
    ),
    main(
        "agent-collisions", "430, table", PERFORMANCE,
        "The term costs few to no collisions of agents (here: at most 0.05 of the episodes)",
        keeps("no_agent_collision", RATE_MARGIN),
    ),
    main(
        "object-collisions", "430, table", PERFORMANCE,
        "The term costs few to no collisions with the wall (here: at most 0.05 of the episodes)",
        keeps("no_object_collision", RATE_MARGIN), cells=PASSAGE_CELLS,
    ),
    main(
        "makespan", "430, table", PERFORMANCE,
        "The term costs little to no time (here: at most 20 steps)",
        keeps("makespan", MAKESPAN_MARGIN),
    ),
    main(
        "graphmask-net", "558", APPENDIX,
        "What GraphMask gains in Fid- and loses in Fid+ leaves little net benefit in FidDelta",
        improves(GRAPHMASK, "fid_minus"), worsens(GRAPHMASK, "fid_plus"), unmoved(GRAPHMASK, "fid_delta"),
    ),
    main(
        "gnn-fid-plus-mixed", "558", APPENDIX,
        "The term has mixed results for GNNExplainer's Fid+",
        improves(GNN, "fid_plus"), quantifier=Quantifier.MIXED,
    ),
    main(
        "gnn-fid-minus-mixed", "558", APPENDIX,
        "The term has mixed results for GNNExplainer's Fid-",
        improves(GNN, "fid_minus"), quantifier=Quantifier.MIXED,
    ),
    main(
        "attention-fid-plus", "558", APPENDIX,
        "The term consistently improves AttentionExplainer's Fid+",
        improves(ATTENTION, "fid_plus"), quantifier=Quantifier.EVERY,
    ),
    main(
        "attention-fid-minus", "558", APPENDIX,
        "The term consistently improves AttentionExplainer's Fid-",
        improves(ATTENTION, "fid_minus"), quantifier=Quantifier.EVERY,
    ),
    main(
        "attention-fid-delta", "558", APPENDIX,
        "The term improves AttentionExplainer's FidDelta (the paper: by much)",
        improves(ATTENTION, "fid_delta"), quantifier=Quantifier.EVERY,
    ),
)  # fmt: skip
