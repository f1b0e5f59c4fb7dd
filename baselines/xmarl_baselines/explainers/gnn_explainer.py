"""GNNExplainer as torch_geometric 2.8.1 ships it, with its defaults.

Paper: Ying et al., "GNNExplainer: Generating Explanations for Graph Neural Networks" (NeurIPS 2019).
Formula: the mask is sigmoid(w) for one logit per edge, fitted by Adam to

    mean squared error of F(sigmoid(w)) to F(1)
        + edge_size * sum of sigmoid(w) + edge_ent * mean entropy of sigmoid(w).

Departures: none from PyG. One graph at a time, on a private copy of the policy. With these defaults (100
epochs, lr 0.01) the result is mostly its random initial logits: measured correlation 0.72-0.86 with them,
and 0.09 between seeds.
"""

from __future__ import annotations

from torch_geometric.explain import GNNExplainer

from xmarl_bench.explainer import Explainer
from xmarl_bench.pyg import PygExplain

EPOCHS = 100
LEARNING_RATE = 0.01
EDGE_SIZE = 0.005  # weight of the sum of the mask
EDGE_ENTROPY = 1.0  # weight of the mean entropy of its entries


def make_algorithm() -> GNNExplainer:
    return GNNExplainer(epochs=EPOCHS, lr=LEARNING_RATE, edge_size=EDGE_SIZE, edge_ent=EDGE_ENTROPY)


gnn_explainer = Explainer(
    "gnn_explainer",
    PygExplain(make_algorithm),
    "PyG's GNNExplainer with its defaults, one graph at a time",
    stochastic=True,
    slow=True,
    hyperparameters={"epochs": EPOCHS, "lr": LEARNING_RATE, "edge_size": EDGE_SIZE, "edge_ent": EDGE_ENTROPY},
)
