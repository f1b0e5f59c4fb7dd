"""Functions, classes and objects become explainers by one documented rule, or are refused with a reason."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import pytest
import torch
from torch import Tensor
from torch_geometric.explain import (
    AttentionExplainer,
    CaptumExplainer,
    DummyExplainer,
    ExplainerAlgorithm,
    GNNExplainer,
    GraphMaskExplainer,
    PGExplainer,
)

from tests.conftest import MakeBundle
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench import as_explainer, score
from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import kebab, origin_of_explainer
from xmarl_bench.explain.effect import NORMALISER, signed_to_unit
from xmarl_bench.explain.explainer import Explainer, fit_explainer, run_explainer
from xmarl_bench.explain.messages_only import messages_only
from xmarl_bench.explain.pyg import PygExplain
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.plugins.registry import checked_name
from xmarl_bench.policy import Policy

QUICK = {"episodes": 2, "timesteps": 2, "max_cycles": 5, "behaviour_episodes": 0}
POLICY, OBSERVATIONS = small_policy(6), random_observations(4, 3, 6)


def attended(observations: Tensor, policy: Policy) -> Tensor:
    """What the layer attends to.

    Not shown in lists.
    """
    return policy.attention(observations)


def swapped(policy: Policy, observations: Tensor) -> Tensor:
    return policy.attention(observations)


def drawn(observations: Tensor, generator: torch.Generator) -> Tensor:
    n_steps, n_agents, _ = observations.shape
    return torch.rand(n_steps, n_agents, n_agents, generator=generator)


def run(thing: object, seed: int = 0, **declared: Any) -> Tensor:
    return run_explainer(as_explainer(thing, **declared), POLICY, OBSERVATIONS, seed)


def test_parameters_are_recognised_by_name() -> None:
    expected = POLICY.attention(OBSERVATIONS)
    for explain in (
        attended,
        swapped,
        lambda policy, temperature=1.0, *, observations: attended(observations, policy),
    ):
        assert torch.equal(run(explain), expected)
    assert not torch.equal(run(drawn, 0), run(drawn, 1))
    assert torch.equal(run(drawn, 1), run(drawn, 1))


@pytest.mark.parametrize(
    ("explain", "said"),
    [
        (lambda obs, net: obs, r"takes \(obs, net\): name its parameters policy, observations"),
        (lambda observations, policy, seed: observations, r"takes \(observations, policy, seed\)"),
        (lambda: None, r"takes \(nothing\)"),
        (max, "has no readable signature"),
        (7, "an int is not an explainer"),
        (None, "a NoneType is not an explainer"),
        ("attention", "a str is not an explainer"),
    ],
)
def test_unsupported_signatures_and_types_are_refused(explain: object, said: str) -> None:
    with pytest.raises(InputError, match=said):
        as_explainer(explain)


def test_the_decorator_records_declarations() -> None:
    @as_explainer
    def plain(observations: Tensor) -> Tensor:
        return torch.zeros(1)

    @as_explainer(name="mine", stochastic=True, hyperparameters={"k": 3}, accesses="attention")
    def declared(observations: Tensor) -> Tensor:
        return torch.zeros(1)

    assert (plain.name, plain.stochastic, plain.accesses) == ("plain", False, None)
    assert (declared.name, declared.stochastic, declared.accesses) == ("mine", True, "attention")
    assert declared.hyperparameters == {"k": 3}
    assert (plain.absence, as_explainer(attended, absence="mean").absence) == (None, Absence.MEAN)
    assert as_explainer(attended).summary == "What the layer attends to."
    assert as_explainer(plain) is plain


@pytest.mark.parametrize(
    ("declared", "said"),
    [
        ({"stochastc": True}, "declares 'stochastc': choose among name"),
        ({"stochastic": 1}, "stochastic = 1: give True or False"),
        ({"accesses": "weights"}, "accesses = 'weights': give one of black-box, attention, gradients"),
        ({"node_importance": "yes"}, "node_importance = 'yes': give True, False or None"),
        ({"absence": "gone"}, "absence = 'gone': give one of zero, mean, resample, renormalised"),
        ({"hyperparameters": {"layers": [1, 2]}}, "give a dict of names and finite numbers"),
        ({"hyperparameters": {"level": math.inf}}, "give a dict of names and finite numbers"),
        ({"hyperparameters": {"x" * 10_001: 1}}, "give a dict of names and finite numbers"),
        ({"name": 3}, "name = 3: give a string"),
        ({"needs_fit": True}, "give it a method fit"),
    ],
)
def test_invalid_declarations_are_refused(declared: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        as_explainer(attended, **declared)
    if declared.keys() <= {"stochastic", "accesses", "absence", "hyperparameters"}:
        with pytest.raises(InputError, match=said):
            Explainer("own", attended, **declared)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="run the network itself"):
        as_explainer(GNNExplainer(), accesses="black-box")
    with pytest.raises(InputError, match="exists already"):
        as_explainer(as_explainer(attended), slow=True)


@dataclass
class Tempered:
    """Attention, flattened."""

    temperature: float = 2.0
    accesses = "attention"

    def explain(self, observations: Tensor, policy: Policy) -> Tensor:
        return policy.attention(observations) ** (1 / self.temperature)


@pytest.mark.parametrize("value", [math.inf, math.nan, 10**19, "x" * 10_001])
def test_what_an_entry_cannot_record_is_no_hyperparameter(value: Any) -> None:
    """Found before anything is scored: the entry is made last."""
    assert as_explainer(Tempered(value)).hyperparameters == {}
    with pytest.raises(InputError, match=r"declares hyperparameters = .*: give a dict of names and finite"):
        Explainer("mine", lambda *given: POLICY.attention(given[1]), hyperparameters={"level": value})


def test_classes_and_objects_explain_and_declare() -> None:
    explainer = as_explainer(Tempered)
    assert (explainer.name, explainer.accesses) == ("tempered", "attention")
    assert explainer.hyperparameters == {"temperature": 2.0}
    torch.testing.assert_close(run(Tempered), POLICY.attention(OBSERVATIONS).sqrt())
    torch.testing.assert_close(run(Tempered(1.0)), POLICY.attention(OBSERVATIONS))
    assert as_explainer(Tempered, accesses=None, name="x").accesses is None

    class NeedsMore:
        def __init__(self, depth: int) -> None:
            self.depth = depth

    with pytest.raises(InputError, match="'NeedsMore' cannot be made without arguments"):
        as_explainer(NeedsMore)


def test_a_torch_module_is_called_with_what_its_forward_names() -> None:
    class Learned(torch.nn.Module):
        def forward(self, observations: Tensor, policy: Policy) -> Tensor:
            return policy.attention(observations)

    assert as_explainer(Learned()).name == "learned"
    torch.testing.assert_close(run(Learned()), POLICY.attention(OBSERVATIONS))


def test_the_keywords_of_a_partial_are_its_hyperparameters() -> None:
    def tempered(observations: Tensor, policy: Policy, temperature: float = 1.0) -> Tensor:
        """Attention, sharper or flatter."""
        return policy.attention(observations) ** temperature

    explainer = as_explainer(partial(tempered, temperature=2.0))
    assert (explainer.name, explainer.summary) == ("tempered", "Attention, sharper or flatter.")
    assert explainer.hyperparameters == {"temperature": 2.0}
    assert torch.equal(run(explainer), POLICY.attention(OBSERVATIONS) ** 2.0)


def test_an_unbatched_explainer_is_called_for_one_timestep_at_a_time() -> None:
    shapes: list[tuple[int, ...]] = []

    def one(observations: Tensor, policy: Policy, generator: torch.Generator) -> Tensor:
        shapes.append(tuple(observations.shape))
        return policy.attention(observations[None])[0] * torch.rand((), generator=generator)

    mask = run(one, batched=False, stochastic=True)
    assert shapes == [(3, 6)] * 4
    scale = mask.sum(dim=-1)[:, 0]
    assert len(set(scale.tolist())) == 4  # each timestep has its own random stream
    torch.testing.assert_close(mask, POLICY.attention(OBSERVATIONS) * scale[:, None, None])
    with pytest.raises(InputError, match=r"shape \(4, 3, 3\): return shape \(3, 3\)"):
        run(lambda observations: torch.ones(4, 3, 3), batched=False)


@pytest.mark.slow
def test_signed_is_normalised_by_the_harness_and_recorded(make_bundle: MakeBundle) -> None:
    def signed(observations: Tensor) -> Tensor:
        return 100 * (observations[:, :, None, 0] - observations[:, None, :, 1])

    torch.testing.assert_close(run(signed, signed=True), signed_to_unit(signed(OBSERVATIONS)))
    with pytest.raises(InputError, match="scale them"):
        run(signed)
    with pytest.raises(InputError, match="NaN or infinity"):
        run(lambda observations: torch.full((4, 3, 3), math.nan), signed=True)
    entry = score(make_bundle(), as_explainer(signed, signed=True), **QUICK)  # type: ignore[arg-type]
    assert entry.explainer.signed == NORMALISER


def test_a_binary_explainer_may_return_only_zeros_and_ones() -> None:
    assert set(run(lambda observations: torch.eye(3).expand(4, 3, 3), binary=True).unique().tolist()) == {
        0,
        1,
    }
    with pytest.raises(InputError, match="declares binary masks"):
        run(attended, binary=True)


def test_a_black_box_has_no_parameters_layers_or_gradients() -> None:
    seen: list[Policy] = []

    def explain(observations: Tensor, policy: Policy) -> Tensor:
        seen.append(policy)
        kept = torch.rand(len(observations), 3, 3)
        answered = policy.distribution(observations, kept.requires_grad_())
        assert torch.equal(answered.loc, POLICY.distribution(observations, kept).loc)
        edges = torch.tensor([[0, 1, 2, 1], [0, 1, 2, 0]])
        assert torch.equal(policy(observations[0], edges), POLICY(observations[0], edges))
        assert not answered.loc.requires_grad
        assert not policy.prepare(observations)(kept).loc.requires_grad
        assert not list(policy.parameters())
        assert not list(policy.children())
        return torch.ones(len(observations), 3, 3)

    run(explain, accesses="black-box")
    assert not hasattr(seen[0], "gat")
    with pytest.raises(InputError, match="the explainer reads attention but does not declare it"):
        run(attended, accesses="black-box")
    assert torch.equal(run(attended, accesses="attention"), run(attended))


class Learner:
    """Learns the mean of what it is fitted on."""

    needs_fit = True

    def fit(self, observations: Tensor, policy: Policy, generator: torch.Generator) -> None:
        self.mean = observations.mean()
        self.noise = torch.rand((), generator=generator)

    def explain(self, observations: Tensor) -> Tensor:
        return torch.sigmoid(self.mean + self.noise).expand(len(observations), 3, 3)


def test_who_names_a_simulator_is_given_that_of_the_episode() -> None:
    def wherever(observations: Tensor, simulator: Simulator, policy: Policy) -> Tensor:
        """Agents that are where they were observed."""
        found = torch.from_numpy(simulator.restart(policy, observations).state.position).float()
        return torch.eye(3) * (found - observations[..., :2]).abs().amax(dim=(1, 2), keepdim=True).lt(1e-6)

    class Learned:
        needs_fit = True

        def fit(self, observations: Tensor) -> None:
            self.seen = len(observations)

        def explain(self, policy: Policy, observations: Tensor, simulator: Simulator) -> Tensor:
            assert self.seen == len(OBSERVATIONS)
            return wherever(observations, simulator, policy)

    plain, fitted = as_explainer(wherever), fit_explainer(as_explainer(Learned), POLICY, OBSERVATIONS, 0)
    simulator = Simulator("blind_navigation_v0", 3, 7)
    for explainer in (plain, fitted):
        assert explainer.simulates
        with pytest.raises(InputError, match=f"{explainer.name}' plays on in the world of an episode"):
            run_explainer(explainer, POLICY, OBSERVATIONS, 0)
        mask = run_explainer(replace(explainer, simulator=simulator), POLICY, OBSERVATIONS, 0)
        assert torch.equal(mask, torch.eye(3).expand_as(mask))
    assert not as_explainer(attended).simulates
    assert origin_of_explainer(plain).entry_point.endswith("wherever")
    with pytest.raises(InputError, match="cannot be asked about messages alone"):
        messages_only(wherever)

    class Clairvoyant(Learner):
        def fit(self, observations: Tensor, simulator: Simulator) -> None: ...  # type: ignore[override]

    with pytest.raises(InputError, match=r"takes \(observations, simulator\)"):
        as_explainer(Clairvoyant)


def test_an_explainer_that_learns_is_fitted_first_on_a_copy() -> None:
    mine = Learner()
    explainer = as_explainer(mine)
    with pytest.raises(InputError, match="'learner' is not fitted"):
        run_explainer(explainer, POLICY, OBSERVATIONS, 0)
    one, same, other = (fit_explainer(explainer, POLICY, OBSERVATIONS, seed) for seed in (1, 1, 2))
    masks = [run_explainer(each, POLICY, OBSERVATIONS, 0) for each in (one, same, other)]
    assert torch.equal(masks[0], masks[1])
    assert not torch.equal(masks[0], masks[2])
    assert not hasattr(mine, "mean")
    assert fit_explainer(as_explainer(attended), POLICY, OBSERVATIONS, 0) == as_explainer(attended)

    class Fails(Learner):
        def fit(self, observations: Tensor) -> None:  # type: ignore[override]
            raise RuntimeError("too little")

    with pytest.raises(InputError, match=r"'fails' failed on 4 timesteps to be fitted on .*too little"):
        fit_explainer(as_explainer(Fails), POLICY, OBSERVATIONS, 0)


ALGORITHMS: dict[str, Callable[[], ExplainerAlgorithm]] = {
    "gnn-explainer": lambda: GNNExplainer(epochs=3, edge_size=0.25),
    "dummy-explainer": DummyExplainer,
    "attention-explainer": AttentionExplainer,
    "graph-mask-explainer": lambda: GraphMaskExplainer(1, epochs=2, log=False),
    "pg-explainer": lambda: PGExplainer(epochs=1),
    "captum-saliency": lambda: CaptumExplainer("Saliency"),
    "captum-input-x-gradient": lambda: CaptumExplainer("InputXGradient"),
    "captum-integrated-gradients": lambda: CaptumExplainer("IntegratedGradients", n_steps=5),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ALGORITHMS)
def test_algorithms_of_pyg_and_captum_work_unmodified(name: str) -> None:
    torch.manual_seed(len(name))  # random numbers drawn by its constructor must not matter
    explainer = as_explainer(ALGORITHMS[name]())
    assert explainer.name == name
    assert explainer.signed == name.startswith("captum")
    masks = []
    for each in (explainer, as_explainer(ALGORITHMS[name]())):
        ready = fit_explainer(each, POLICY, OBSERVATIONS[:2], 5)
        masks.append(run_explainer(ready, POLICY, OBSERVATIONS, 7))
    assert torch.equal(masks[0], masks[1])
    assert float(masks[0].std()) > 0 or "mask" in name
    origin = origin_of_explainer(explainer)
    assert origin.distribution == "torch-geometric"
    assert origin.entry_point.endswith(f":{type(ALGORITHMS[name]()).__name__}")


def test_settings_of_an_algorithm_are_recorded_and_not_overwritten_by_another() -> None:
    one = as_explainer(GraphMaskExplainer(1, epochs=2, log=False, node_feat_size=3.0))
    GraphMaskExplainer(1, node_feat_size=77.0)  # PyG keeps these on the class
    assert one.hyperparameters["node_feat_size"] == 3.0
    assert isinstance(one.explain, PygExplain)
    assert one.explain.algorithm().coeffs["node_feat_size"] == 3.0
    assert as_explainer(GNNExplainer(epochs=3, edge_size=0.25)).hyperparameters.items() >= {
        "epochs": 3, "lr": 0.01, "edge_size": 0.25,
    }.items()  # fmt: skip


@pytest.mark.parametrize(
    "thing", [attended, Tempered, GNNExplainer(epochs=2), PGExplainer(epochs=1), Learner]
)
def test_explainers_can_be_sent_to_worker_processes(thing: object) -> None:
    explainer = fit_explainer(as_explainer(thing), POLICY, OBSERVATIONS[:2], 0)
    again: Explainer = pickle.loads(pickle.dumps(explainer))
    expected = run_explainer(explainer, POLICY, OBSERVATIONS, 1)
    assert torch.equal(run_explainer(again, POLICY, OBSERVATIONS, 1), expected)


@pytest.mark.slow
def test_the_origin_of_an_explainer_is_recorded(make_bundle: MakeBundle) -> None:
    others = partial(attended), messages_only(as_explainer(attended))
    for thing in (attended, Tempered, Tempered(), Tempered().explain, *others):
        origin = origin_of_explainer(as_explainer(thing))
        assert (
            origin.entry_point == f"{__name__}:{'attended' if thing in (attended, *others) else 'Tempered'}"
        ), origin
        assert origin.code_sha256 is not None
    known, another = (origin_of_explainer(as_explainer(each)).code_sha256 for each in (attended, swapped))
    assert known != another
    assert score(make_bundle(), attended, **QUICK).explainer.code_sha256 == known  # type: ignore[arg-type]
    with pytest.raises(InputError, match="has the name of a control"):
        checked_name(replace(as_explainer(attended), name="random"))
    with pytest.raises(InputError, match="cannot be part of a file name"):
        checked_name(replace(as_explainer(attended), name="../x"))


@pytest.mark.parametrize(
    ("name", "kebabed"),
    [
        ("GNNExplainer", "gnn-explainer"),
        ("my_own", "my_own"),
        ("Nearest2First", "nearest2-first"),
        ("<lambda>", "lambda"),
    ],
)
def test_names_for_files(name: str, kebabed: str) -> None:
    assert kebab(name) == kebabed
