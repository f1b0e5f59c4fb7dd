"""Trained policies with states that they reach, and PyG's explainers run as in PyG's manual."""

from __future__ import annotations

import copy

import numpy as np
import torch
from torch import Tensor
from torch_geometric.explain import Explainer as PygExplainer
from torch_geometric.explain import ExplainerAlgorithm, ModelConfig
from xmarl_baselines.policies import shipped_policies
from xmarl_baselines.training.families import FAMILIES, Family
from xmarl_envs import TASKS, make_task

from xmarl_bench.policy import GraphPolicy, Policy, complete_graph, load_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.default_policies import is_checkpoint
from xmarl_bench.rollout.episodes import roll_out


def shipped_name(task: str, n_agents: int = 3, family: Family = FAMILIES[0]) -> str:
    """The shipped policy of seed 0 without the attention-entropy term, of `family` if there is one."""
    cell = (task, n_agents, 0.0, 0)
    cards = [
        card
        for card in map(load_card, shipped_policies().values())
        if (card.task, card.n_agents, card.attention_entropy, card.training_seed) == cell
        and not is_checkpoint(card)
    ]
    return min(cards, key=lambda card: card.family != family).name


TRAINED = [shipped_name(task) for task in TASKS]


def trained(name: str, n_steps: int, n_agents: int = 3) -> tuple[GraphPolicy, Tensor]:
    """A shipped policy and `n_steps` states (n_steps, N, D), spread over an episode of at most 120 steps."""
    policy, card = load_policy(shipped_policies()[name])
    assert isinstance(policy, GraphPolicy)
    (episode,) = roll_out(make_task(card.task, n_agents), policy, [1], max_cycles=120)
    chosen = np.linspace(0, len(episode.observations) - 1, n_steps).astype(int)
    return policy, torch.tensor(episode.observations[chosen])


def by_pyg(policy: Policy, algorithm: ExplainerAlgorithm, x: Tensor, seed: int = 0) -> Tensor:
    """(N, D) -> (N, N): PyG on one graph, after `torch.manual_seed(seed)`."""
    explainer = PygExplainer(
        model=copy.deepcopy(policy),
        algorithm=algorithm,
        explanation_type="model",
        edge_mask_type="object",
        model_config=ModelConfig(mode="regression", task_level="node"),
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        mask: Tensor = explainer(x, complete_graph(len(x))).edge_mask
    return mask.detach().reshape(len(x), len(x))
