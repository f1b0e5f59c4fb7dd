"""Promises of every shipped explainer: no side effects, repeatable, independent of chunks, on any policy."""

from __future__ import annotations

import copy
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn
from torch_geometric.explain import AttentionExplainer, GraphMaskExplainer, PGExplainer
from torch_geometric.nn import GraphConv
from xmarl_baselines.explainers import batching, gnn_explainer, gnn_explainer_tuned, graphmask
from xmarl_baselines.explainers import graphmask_pyg as by_pyg_s_graphmask
from xmarl_baselines.explainers.attention import attention
from xmarl_baselines.explainers.attention_rowmax import attention_rowmax
from xmarl_baselines.explainers.graphmask_pyg import graphmask_pyg
from xmarl_baselines.explainers.influence import influence

from tests.baselines.reference import by_pyg
from tests.helpers.deep_policies import Opened, one_layer, transformers, two_layers, with_a_lonely_timestep
from tests.helpers.policies import random_observations, small_policy
from tests.helpers.recurrent_policies import random_weights, recurrent_policy, remembering
from tests.helpers.shipped import ready, shipped_explainers, shipped_plugins
from xmarl_bench.errors import InputError
from xmarl_bench.explain.control_names import MESSAGES_ONLY
from xmarl_bench.explain.explainer import Explainer, explain_of, run_explainer
from xmarl_bench.explain.pyg import PygExplain
from xmarl_bench.policy import ModulePolicy, Policy
from xmarl_bench.policy.build import LayeredPolicy
from xmarl_bench.policy.layers import LayeredNetwork

SHIPPED = shipped_explainers()
# PyG's own, unmodified: the first leaves settings on its class, which the next one could pick up.
UNMODIFIED = [
    Explainer("pg, one large weight", PygExplain(lambda: PGExplainer(epochs=2, lr=0.1, edge_size=50.0))),
    Explainer("pg", PygExplain(lambda: PGExplainer(epochs=2, lr=0.1))),
    Explainer("graphmask of PyG", PygExplain(lambda: GraphMaskExplainer(1, 5, log=False))),
]


def every(explainers: list[Explainer]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("explainer", explainers, ids=lambda explainer: explainer.name)


each = every(SHIPPED)
# Influence refuses policies whose coefficients are not known: see test_influence.py.
on_any_network = every([explainer for explainer in SHIPPED if explainer is not influence])
# What `-messages` adds does not depend on the network: see test_messages_only.py.
of_all_edges = [explainer for explainer in SHIPPED if not explainer.name.endswith(MESSAGES_ONLY)]


@pytest.fixture(scope="module", autouse=True)
def few_epochs() -> Iterator[None]:
    """These promises do not depend on how long an explainer learns."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (gnn_explainer, gnn_explainer_tuned, graphmask, by_pyg_s_graphmask):
            patch.setattr(module, "SETTINGS", replace(module.SETTINGS, epochs=10))
        yield


def run(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> Tensor:
    """As scoring runs it, fitted where it needs that."""
    return run_explainer(ready(explainer, policy, observations), policy, observations, seed)


def straight(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> Tensor:
    """Without the harness's own copies around it."""
    explain = explain_of(ready(explainer, policy, observations))
    return explain(policy, observations, torch.Generator().manual_seed(seed))


def everything_of(module: nn.Module) -> dict[str, Any]:
    """The observable state of a module: weights, gradients, flags, and the hooks of every submodule."""
    state: dict[str, Any] = {name: part.tolist() for name, part in module.state_dict().items()}
    for name, parameter in module.named_parameters():
        state[f"{name}.flags"] = parameter.requires_grad, parameter.grad is None
    for name, part in module.named_modules():
        state[f"{name}.training"] = part.training
        for key, value in vars(part).items():
            if "hooks" in key:
                state[f"{name}.{key}"] = len(value)
            elif key in ("_explain", "_edge_mask", "_loop_mask", "_apply_sigmoid"):
                state[f"{name}.{key}"] = value
    return state


def test_every_explainer_has_a_file_that_names_its_paper() -> None:
    names = {explainer.name for explainer in SHIPPED}
    assert {name for name in names if not name.endswith(MESSAGES_ONLY)} == {
        "agent-shapley", "attention", "attention-rowmax", "gnn_explainer", "gnn_explainer-tuned", "gradient",
        "graphmask", "graphmask-pyg", "influence", "integrated_gradients", "occlusion", "shapley",
    }  # fmt: skip
    for plugin in shipped_plugins():
        module = __import__(plugin.module, fromlist=["_"])
        assert module.__name__.rsplit(".", 1)[1] == plugin.name.removesuffix(MESSAGES_ONLY).replace("-", "_")
        card = str(module.__doc__)
        assert "Paper" in card or "Source" in card, card
        assert "Departures" in card or "Source: the benchmark's own" in card, card


@pytest.mark.parametrize("residual", [False, True])
def test_attention_is_what_pyg_calls_attention(residual: bool) -> None:
    policy, observations = small_policy(6, 1, residual=residual), random_observations(6, 4, 6)
    mask = run_explainer(attention, policy, observations, 0)
    theirs = torch.stack([by_pyg(policy, AttentionExplainer(), x) for x in observations])
    torch.testing.assert_close(mask, theirs, rtol=0, atol=1e-6)
    torch.testing.assert_close(mask.sum(-1), torch.ones(6, 4))
    assert not torch.allclose(mask, mask.transpose(1, 2))  # so a transposed mask would fail


def test_attention_of_several_heads_and_layers_sums_to_one_where_pygs_does_not() -> None:
    policy, observations = transformers(6), random_observations(3, 4, 6)
    mask = run_explainer(attention, policy, observations, 0)
    torch.testing.assert_close(mask.sum(-1), torch.ones(3, 4))
    theirs = torch.stack([by_pyg(policy, AttentionExplainer(), x) for x in observations])
    assert float(theirs.sum(-1).max()) > 1.05
    means = torch.stack([by_pyg(policy, AttentionExplainer(reduce="mean"), x) for x in observations])
    torch.testing.assert_close(mask, means, rtol=0, atol=1e-6)


def test_attention_rowmax_ranks_as_attention_and_keeps_the_best_message_whole() -> None:
    policy, observations = small_policy(6, 1), random_observations(6, 4, 6)
    alpha = run_explainer(attention, policy, observations, 0)
    mask = run_explainer(attention_rowmax, policy, observations, 0)
    assert torch.equal(mask.argsort(dim=-1), alpha.argsort(dim=-1))
    assert torch.equal(mask.amax(dim=-1), torch.ones(6, 4))
    torch.testing.assert_close(mask * alpha.amax(dim=-1, keepdim=True), alpha)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("explainer", "policy"),
    [
        *((explainer, small_policy(6, 2, residual=True)) for explainer in SHIPPED),
        *((explainer, small_policy(6, 2, categorical=True)) for explainer in of_all_edges),
        *((explainer, two_layers(6)) for explainer in of_all_edges if explainer is not influence),
    ],
    ids=lambda it: it.name if isinstance(it, Explainer) else "",
)
def test_an_explainer_leaves_no_trace(explainer: Explainer, policy: Policy) -> None:
    observations = random_observations(2, 2, 6)
    state, seen = everything_of(policy), observations.clone()
    with torch.no_grad():
        plain = policy.distribution(observations).loc
    before, coefficients = torch.random.get_rng_state(), copy.deepcopy(GraphMaskExplainer.coeffs)
    straight(explainer, policy, observations, 1)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert torch.equal(observations, seen)
    assert everything_of(policy) == state
    with torch.no_grad():
        assert torch.equal(policy.distribution(observations).loc, plain)
    assert coefficients == GraphMaskExplainer.coeffs


@each
def test_an_explainer_repeats_and_only_the_stochastic_depend_on_the_seed(explainer: Explainer) -> None:
    policy, observations = small_policy(6, 3), random_observations(2, 3, 6)
    first = run(explainer, policy, observations, 1)
    torch.manual_seed(99)  # the global state must not matter
    assert torch.equal(first, run(explainer, policy, observations, 1))
    if not explainer.stochastic:
        assert torch.equal(first, run(explainer, policy, observations, 2))


@pytest.fixture(scope="module")
def alone() -> dict[str, Tensor]:
    """The mask of each explainer on its own copies of policy and states."""
    return {
        explainer.name: straight(explainer, small_policy(6, 4, (8,)), random_observations(2, 3, 6), 5)
        for explainer in [*SHIPPED, *UNMODIFIED]
    }


@pytest.mark.slow
@settings(max_examples=3)
@given(order=st.permutations([*SHIPPED, *UNMODIFIED]))
def test_no_explainer_leaks_into_the_next_whatever_the_order(
    alone: dict[str, Tensor], order: list[Explainer]
) -> None:
    """On shared objects, without copies, each gives the same mask as alone."""
    assert (alone["pg"] - alone["pg, one large weight"]).abs().max() > 0.01  # so a leak would fail
    policy, observations = small_policy(6, 4, (8,)), random_observations(2, 3, 6)
    for explainer in order:
        mask = straight(explainer, policy, observations, 5)
        assert torch.equal(mask, alone[explainer.name]), explainer.name


@pytest.mark.slow
@every([each for each in SHIPPED if each is not graphmask_pyg])  # rounding may move a gate, as in PyG itself
def test_chunks_change_nothing_but_rounding(explainer: Explainer, monkeypatch: pytest.MonkeyPatch) -> None:
    policy, observations = small_policy(6, 5), random_observations(7, 3, 6)
    whole = run(explainer, policy, observations, 1)
    monkeypatch.setattr(batching, "AGENTS_AT_ONCE", 6)
    assert len(list(batching.chunks(7, 3))) == 4
    parts = run(explainer, policy, observations, 1)
    assert not whole.isnan().any()
    torch.testing.assert_close(whole, parts, rtol=0, atol=1e-4)


@each
def test_a_timestep_s_mask_does_not_depend_on_other_timesteps(explainer: Explainer) -> None:
    policy, observations = small_policy(6, 3), random_observations(3, 3, 6)
    one = run(explainer, policy, observations, 1)
    changed = observations.clone()
    changed[0] += 1.0
    two = run(explainer, policy, changed, 1)
    assert torch.equal(one[1:], two[1:])


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"residual": True}, {"categorical": True}], ids=str)
@every([each for each in of_all_edges if each is not influence])
def test_the_generic_path_gives_what_the_fast_path_gives(
    explainer: Explainer, options: dict[str, Any]
) -> None:
    policy, observations = small_policy(6, 6, **options), random_observations(4, 3, 6)
    fast = run(explainer, policy, observations, 3)
    a = policy.architecture
    opened = ModulePolicy(Opened(policy), 6, a.action_dim, distribution=a.distribution)
    generic = run(explainer, opened, observations, 3)
    # Small changes of actions, divided by the row's largest, amplify float32's rounding.
    torch.testing.assert_close(fast, generic, rtol=0, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "after"), [("lstm", 0), ("gru", 1)])
@every([each for each in of_all_edges if each is not influence])
def test_the_paths_agree_on_policies_that_remember(explainer: Explainer, cell: str, after: int) -> None:
    architecture = remembering(cell, after)
    fast, network = recurrent_policy(architecture), LayeredNetwork(architecture)
    network.load_state_dict(random_weights(architecture))
    observations = random_observations(4, 3, 6 + fast.memory_dim)
    one = run(explainer, fast, observations, 3)
    other = run(explainer, LayeredPolicy(architecture, network), observations, 3)
    torch.testing.assert_close(one, other, rtol=0, atol=1e-3)


@pytest.mark.slow
@on_any_network
def test_agents_that_hear_nobody_get_rows_of_zeros(explainer: Explainer) -> None:
    policy, observations, edges = with_a_lonely_timestep()
    assert not edges[1].any()
    assert edges.any()
    mask = run(explainer, policy, observations, 3)
    assert not mask[~edges].any()


@pytest.mark.slow
@on_any_network
def test_policies_without_attention_are_explained_by_explainers_that_need_none(explainer: Explainer) -> None:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        policy = ModulePolicy(GraphConv(6, 4), 6)
    if explainer.name in ("attention", "attention-rowmax"):
        with pytest.raises(InputError, match="no attention layer"):
            run(explainer, policy, random_observations(2, 3, 6), 3)
    else:
        run(explainer, policy, random_observations(2, 3, 6), 3)


@pytest.mark.slow
@pytest.mark.parametrize("policy", [one_layer(6), two_layers(6), transformers(6)], ids=["1", "2", "3"])
@on_any_network
def test_policies_beyond_the_fast_path_are_explained(explainer: Explainer, policy: Policy) -> None:
    observations = random_observations(2, 2, 6)
    if explainer is graphmask_pyg and "Transformer" in str(policy):
        with pytest.raises(InputError, match="TransformerConv"):  # PyG's own does not work there
            run(explainer, policy, observations, 3)
        return
    mask = run(explainer, policy, observations, 3)
    changed = observations.clone()
    changed[0] += 1.0
    others = run(explainer, policy, changed, 3)[1:]
    torch.testing.assert_close(mask[1:], others, rtol=0, atol=1e-5)  # objectives are uncoupled


PEAK = """
import os, resource, sys
from dataclasses import replace
from importlib.metadata import entry_points
from xmarl_baselines.explainers import gnn_explainer
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain.control_names import MESSAGES_ONLY
from xmarl_bench.explain.explainer import run_explainer
gnn_explainer.SETTINGS = replace(gnn_explainer.SETTINGS, epochs=3)  # as much memory as 100, in less time
for name in sys.argv[1:]:
    if os.fork():  # peak memory never falls, so each runs in its own process
        os.wait()
        continue
    (plugin,) = [p for p in entry_points(group="xmarl_bench.explainers") if p.name == name]
    for n_steps in (256, 2048):  # chunks are of 256 timesteps at N = 8
        run_explainer(plugin.load(), small_policy(6), random_observations(n_steps, 8, 6), 0)
        print(name, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, flush=True)
    os._exit(0)
"""


@pytest.mark.slow
def test_peak_memory_is_bounded_by_the_chunk() -> None:
    """In kilobytes."""
    names = ["gnn_explainer", "shapley"]
    ran = subprocess.run(
        [sys.executable, "-c", PEAK, *names], capture_output=True, text=True, check=True, timeout=300
    )
    lines = [line.split() for line in ran.stdout.splitlines()]
    assert [name for name, _ in lines] == ["gnn_explainer"] * 2 + ["shapley"] * 2
    for (name, few), (_, many) in zip(lines[::2], lines[1::2], strict=True):
        assert int(many) - int(few) < 30_000, (name, few, many)
