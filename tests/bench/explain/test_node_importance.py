"""Importances of nodes become masks: the importance of agent j fills column j, that of the sender."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch_geometric.explain import CaptumExplainer, Explanation, GNNExplainer, ModelConfig
from torch_geometric.explain import Explainer as PygExplainer

from tests.conftest import MakeBundle
from tests.helpers.libraries import library
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench import as_explainer, score
from xmarl_bench.errors import InputError
from xmarl_bench.explain.effect import signed_to_unit
from xmarl_bench.explain.explainer import run_explainer
from xmarl_bench.explain.messages_only import messages_only
from xmarl_bench.policy import Policy, complete_graph

POLICY = small_policy(6)
FOUR, THREE = random_observations(4, 3, 6), random_observations(3, 3, 6)  # timesteps of three agents


def speed(observations: Tensor) -> Tensor:
    """(S, N, D) -> (S, N), or (N, D) -> (N,)."""
    return torch.sigmoid(observations[..., 2])


def run(explain: object, observations: Tensor = FOUR, **declared: Any) -> Tensor:
    return run_explainer(as_explainer(explain, **declared), POLICY, observations, 0)


def of_senders(importance: Tensor) -> Tensor:
    """(S, N) -> (S, N, N), written out."""
    n_steps, n_agents = importance.shape
    mask = torch.zeros(n_steps, n_agents, n_agents)
    for j in range(n_agents):
        mask[:, :, j] = importance[:, j, None]
    return mask


def test_the_shape_tells_unless_it_is_ambiguous() -> None:
    assert torch.equal(run(speed), of_senders(speed(FOUR)))
    assert torch.equal(run(speed, THREE, batched=False), of_senders(speed(THREE)))  # (N,) is unambiguous
    with pytest.raises(InputError, match=r"\(3, 3\) for 3 timesteps of 3 agents, which could be the mask of"):
        run(speed, THREE)


def test_a_declaration_decides() -> None:
    assert torch.equal(run(speed, THREE, node_importance=True), of_senders(speed(THREE)))
    assert torch.equal(run(speed, batched=False, node_importance=True), of_senders(speed(FOUR)))
    with pytest.raises(InputError, match=r"returned shape \(4, 3, 3\): return \(4, 3\), or leave the"):
        run(lambda observations: torch.ones(4, 3, 3), node_importance=True)
    for observations in (FOUR, THREE):
        with pytest.raises(InputError, match=r"return shape \(., 3, 3\)"):
            run(speed, observations, node_importance=False)


def test_signed_importances_are_normalised_after_they_are_spread() -> None:
    mask = run(lambda observations: 100 * observations[..., 2], signed=True)
    torch.testing.assert_close(mask, signed_to_unit(of_senders(FOUR[..., 2])))
    with pytest.raises(InputError, match="scale them"):
        run(lambda observations: 100 * observations[..., 2])


def test_messages_only_keeps_own_edges() -> None:
    for observations in (FOUR, THREE):
        asked = messages_only(as_explainer(speed, node_importance=True))
        mask = run_explainer(asked, POLICY, observations, 0)
        own = torch.eye(3, dtype=torch.bool)
        assert torch.equal(mask, of_senders(speed(observations)).masked_fill(own, 1.0))


def test_messages_only_refuses_algorithms_that_mask_the_network_s_own_layers() -> None:
    for algorithm in (GNNExplainer(epochs=1), CaptumExplainer("Saliency")):
        with pytest.raises(InputError, match="masks the network's own layers: it cannot be kept from"):
            messages_only(algorithm)


@pytest.mark.slow
def test_an_entry_records_the_declaration(make_bundle: MakeBundle) -> None:
    policy, quick = make_bundle(), {"episodes": 1, "timesteps": 2, "max_cycles": 3, "behaviour_episodes": 0}
    declared = score(policy, as_explainer(speed, node_importance=True), **quick)  # type: ignore[arg-type]
    assert declared.explainer.node_importance
    undeclared = score(policy, speed, **quick)  # type: ignore[arg-type]
    assert "node_importance" not in undeclared.explainer.model_dump()
    assert undeclared.results[0].metrics == declared.results[0].metrics


def explained(policy: Policy, x: Tensor, **masks: str) -> Explanation:
    return PygExplainer(
        policy, GNNExplainer(epochs=3), explanation_type="model",
        model_config=ModelConfig(mode="regression", task_level="node"), **masks,
    )(x, complete_graph(len(x)))  # fmt: skip


def test_an_explanation_of_torch_geometric_is_taken_as_it_is() -> None:
    def nodes(observations: Tensor, policy: Policy) -> Explanation:
        return explained(policy, observations, node_mask_type="object")

    def each(observations: Tensor, policy: Policy) -> list[Explanation]:
        return [nodes(x, policy) for x in observations]

    mask = run(nodes, batched=False, stochastic=True)
    assert float(mask.std(dim=-1).min()) > 0
    assert bool((mask == mask[:, :1]).all())  # receivers do not differ
    torch.manual_seed(0)
    mask = run(each, THREE, stochastic=True)
    assert mask.shape == (3, 3, 3)
    assert bool((mask == mask[:, :1]).all())

    def edges(observations: Tensor) -> Explanation:
        kept = torch.tensor([0.1, 0.2, 0.3])
        between = torch.tensor([[1, 2, 0], [0, 0, 2]])  # sender, receiver
        return Explanation(edge_index=between, edge_mask=kept, node_mask=torch.ones(3, 1))

    expected = torch.tensor([[0.0, 0.1, 0.2], [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]])
    assert torch.equal(run(edges, batched=False), expected.expand(4, -1, -1))


def test_a_node_mask_of_features_counts_by_its_mean() -> None:
    def features(observations: Tensor) -> Explanation:
        return Explanation(node_mask=torch.tensor([[0.0, 1.0], [1.0, 1.0], [0.0, 0.5]]))

    assert torch.equal(run(features, batched=False)[0, 2], torch.tensor([0.5, 1.0, 0.25]))


@pytest.mark.parametrize(
    ("explanation", "said"),
    [
        (Explanation(x=FOUR[0]), "returned an Explanation with no mask: give one with an edge_mask"),
        (Explanation(node_mask=torch.ones(1, 6)), r"only a node mask of shape \(1, 6\)"),
    ],
)
def test_an_explanation_without_importances_of_nodes_or_edges_is_refused(
    explanation: Explanation, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        run(lambda observations: explanation, batched=False)
    with pytest.raises(InputError, match="one Explanation for 4 timesteps: declare batched = False"):
        run(lambda observations: explanation)


def chi_square(x: str, y: str, z: list[str], data: Any, **options: Any) -> tuple[float, float, int]:
    """scipy's test with the signature of pgmpy's, which needs statsmodels and more."""
    from scipy.stats import chi2_contingency

    table = data.groupby([x, y]).size().unstack(fill_value=0)
    statistic, p, freedom, _ = chi2_contingency(np.asarray(table))
    return statistic, p, freedom


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:'torch_geometric.contrib' contains experimental code")
def test_pgm_explainer_explains_each_agent_by_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    library("pandas")
    for name in ("pgmpy", "pgmpy.estimators", "pgmpy.estimators.CITests"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setattr(sys.modules["pgmpy.estimators.CITests"], "chi_square", chi_square, raising=False)
    from torch_geometric.contrib.explain import PGMExplainer

    explainer = as_explainer(PGMExplainer(num_samples=40))
    policy = small_policy(6, categorical=True)
    mask = run_explainer(explainer, policy, THREE, 1)
    assert set(mask.unique().tolist()) == {0.0, 1.0}
    assert bool((mask.diagonal(dim1=1, dim2=2) == 1).all())  # an agent always explains itself
    assert bool((mask != mask[:, :1]).any())  # receivers differ
    assert torch.equal(mask, run_explainer(explainer, policy, THREE, 1))
    with pytest.raises(InputError, match="PGMExplainer explains neither edges nor nodes of a policy with c"):
        run_explainer(explainer, POLICY, THREE, 1)
