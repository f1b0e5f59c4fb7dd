"""GraphMask as torch_geometric 2.8.1 ships it, bugs and all, for comparability with what others ran.

Paper: Schlichtkrull, De Cao and Titov, "Interpreting Graph Neural Networks for NLP With Differentiable Edge
Masking" (ICLR 2021): hard-concrete gates on unmodified messages, a learned baseline in place of a dropped
message, and the fewest messages under a constraint on the change of the prediction, by a Lagrangian.

What PyG's code does instead on a policy of this benchmark (verified on 2.8.1, not corrected here):

- the explained layer's messages become relu(layer_norm(message)), so it explains another network;
- an untrained feature mask scales the observations although no feature mask was asked for;
- the multiplier lambda is made anew in every epoch, so the constraint never tightens;
- where the layer's input and output sizes differ (navigation: 6 -> 32), the gates are made anew after the
  optimiser was given the old ones: nothing is trained;
- the hard threshold is the midpoint of the smallest and largest gate, so "all gates open" comes out as all
  zeros, and masks are 0 or 1;
- the learned baselines are scalars.

Each graph gets a private copy of the policy, for the algorithm leaves hooks and frozen weights on it.
"""

from __future__ import annotations

from torch_geometric.explain import GraphMaskExplainer

from xmarl_bench.explainer import Explainer
from xmarl_bench.pyg import PygExplain

# PyG's defaults, stated.
EPOCHS = 100
LEARNING_RATE = 0.01
PENALTY_SCALING = 5
LAMBDA_LEARNING_RATE = 0.01
INIT_LAMBDA = 0.55
ALLOWANCE = 0.03


def make_algorithm() -> GraphMaskExplainer:
    # No coefficients: GraphMaskExplainer keeps those on the class, and they would leak to every later graph.
    return GraphMaskExplainer(
        num_layers=1,
        epochs=EPOCHS,
        lr=LEARNING_RATE,
        penalty_scaling=PENALTY_SCALING,
        lambda_optimizer_lr=LAMBDA_LEARNING_RATE,
        init_lambda=INIT_LAMBDA,
        allowance=ALLOWANCE,
        log=False,
    )


graphmask_pyg = Explainer(
    "graphmask-pyg",
    PygExplain(make_algorithm),
    "PyG's GraphMask as it is, known bugs included, one graph at a time",
    stochastic=True,
    slow=True,
    hyperparameters={
        "epochs": EPOCHS,
        "lr": LEARNING_RATE,
        "penalty_scaling": PENALTY_SCALING,
        "lambda_optimizer_lr": LAMBDA_LEARNING_RATE,
        "init_lambda": INIT_LAMBDA,
        "allowance": ALLOWANCE,
    },
)
