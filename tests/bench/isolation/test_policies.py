"""A policy that is code answers from a process of its own, to the bit, and does no harm there."""

from __future__ import annotations

import copy
import json
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import GATConv, GATv2Conv, GraphConv

from tests.bench.policy.test_code import near
from tests.conftest import MakeBundle, RunCli
from tests.helpers.recurrent_policies import AttentionThenGru, drawn
from xmarl_bench import PolicyModule, score
from xmarl_bench.entry.file import read_entries
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import fit_explainer, run_explainer
from xmarl_bench.explain.oracle import ascend
from xmarl_bench.explain.sanity import mask_of_shuffled_weights, shuffled_weights
from xmarl_bench.isolation.asked import AskedPolicy
from xmarl_bench.isolation.conversation import Isolation, end_strangers
from xmarl_bench.isolation.policies import isolate_policy
from xmarl_bench.isolation.tensors import Sent
from xmarl_bench.origin.references import origin_of
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.plugins.registry import ask_explainer
from xmarl_bench.policy import ModulePolicy
from xmarl_bench.policy.interface import NoAttentionError
from xmarl_bench.policy.teams_apart import step_teams
from xmarl_bench.reproducible import one_thread

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="needs processes of Unix")]


@pytest.fixture(autouse=True)
def end() -> Iterator[None]:
    yield
    end_strangers()


class TwoLayers(nn.Module):
    """Attention twice, then a logit for each of five actions."""

    def __init__(self) -> None:
        super().__init__()
        self.first = GATConv(6, 8, heads=2, add_self_loops=False)
        self.second = GATConv(16, 8, add_self_loops=False)
        self.decoder = nn.Linear(8, 7)
        drawn(self)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        hidden = torch.tanh(self.second(torch.tanh(self.first(x, edge_index)), edge_index))
        out: Tensor = self.decoder(hidden)
        return out[:, 1:6]  # a view, whose strides decide how torch rounds


def with_memory() -> PolicyModule:
    return PolicyModule("gru", AttentionThenGru(), "blind_navigation_v0", 3)


def two_layers() -> PolicyModule:
    return PolicyModule("two", TwoLayers(), "blind_navigation_v0", 3, distribution="categorical")


def pair(module: PolicyModule) -> tuple[ModulePolicy, AskedPolicy]:
    here, card = open_module(module, origin_of(module.network))
    apart, its_card = isolate_policy(module, Isolation())
    assert its_card == card
    return copy.deepcopy(here).eval(), apart


def same(one: Tensor, other: Tensor) -> bool:
    """Also the strides, by which later results round."""
    return torch.equal(one, other) and one.stride() == other.stride()


@pytest.mark.parametrize("make", [with_memory, near, two_layers])
def test_answers_are_those_of_the_network_to_the_bit(make: Callable[[], PolicyModule]) -> None:
    here, apart = pair(make())
    assert (here.row_wise, here.memory_dim, here.graph) == (apart.row_wise, apart.memory_dim, apart.graph)
    n_agents = 4
    wide = torch.randn(9, n_agents, 6 + here.memory_dim, generator=torch.Generator().manual_seed(1))
    rows = torch.rand(5, 1, 1, n_agents, generator=torch.Generator().manual_seed(2))
    with one_thread(), torch.no_grad():
        for x in (wide, wide[1:4]):  # the second begins in the middle of a vector of memory
            masks = (None, rows[:1, 0].expand(len(x), n_agents, -1), rows.expand(-1, len(x), n_agents, -1))
            for mask in masks:
                one, other = here.distribution(x, mask), apart.distribution(x, mask)
                assert same(one.loc, other.loc)
                assert same(one.scale, other.scale)
                assert same(one.action, other.action)
                (acted, memory), (also, its_memory) = here.step(x, mask), apart.step(x, mask)
                assert same(acted.loc, also.loc)
                assert same(memory, its_memory)
            assert same(here.attention(x), apart.attention(x))
            assert torch.equal(here.initial_state(n_agents), apart.initial_state(n_agents))
            for mask in (None, torch.eye(n_agents)):
                chosen = zip(step_teams(here)(x, mask), step_teams(apart)(x, mask), strict=True)
                assert all(torch.equal(a, b) and a.dtype == b.dtype for a, b in chosen)
            start = rows[0].expand(len(x), n_agents, -1).round()
            assert torch.equal(ascend(here, x, start), ascend(apart, x, start))  # by gradients
            shuffled = [shuffled_weights(each, 3).distribution(x).loc for each in (here, apart)]
            assert torch.equal(*shuffled)


def test_shipped_explainers_run_beside_the_network() -> None:
    """gnn_explainer needs gradients, graphmask is fitted."""
    here, apart = pair(two_layers())
    x = torch.randn(4, 3, 6, generator=torch.Generator().manual_seed(1))
    for name in ("gnn_explainer", "graphmask"):
        fitted = [fit_explainer(ask_explainer(name), policy, x, 1) for policy in (here, apart)]
        both = list(zip(fitted, (here, apart), strict=True))
        masks = [run_explainer(each, policy, x, 2) for each, policy in both]
        assert torch.equal(*masks)
        assert len(masks[0].unique()) > 1
    again = [mask_of_shuffled_weights(each, policy, x, 0) for each, policy in both]
    assert torch.equal(*again)


def test_explainers_of_others_meet_the_network_in_a_process_for_the_two(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(MEETS)
    here, apart = pair(two_layers())
    x = torch.randn(4, 3, 6, generator=torch.Generator().manual_seed(1))
    meets = ask_explainer(f"{tmp_path / 'own.py'}:meets")
    assert torch.equal(run_explainer(meets, here, x, 0), run_explainer(meets, apart, x, 0))
    with pytest.raises(InputError, match="explainer 'meets' failed"):
        run_explainer(ask_explainer(f"{tmp_path / 'own.py'}:meets"), apart, x * 0, 0)
    before = apart.attention(x)
    with pytest.raises(InputError, match=r"explainer own.py:vandal ended \(exit code 4\)"):
        run_explainer(ask_explainer(f"{tmp_path / 'own.py'}:vandal"), apart, x, 0)
    assert torch.equal(apart.attention(x), before)  # it reached no other process of the policy


MEETS = """
import os

def meets(observations, policy):
    assert float(observations.abs().max()) > 0
    weight = policy.network.first.lin.weight.detach()
    return (policy.attention(observations) * weight.abs().mean()).sigmoid().detach()

def vandal(observations, policy):
    policy.network.first.lin.weight.data.zero_()
    os._exit(4)
"""


def test_a_policy_without_attention_says_so_here_too() -> None:
    class Sums(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layer = GraphConv(6, 4)
            drawn(self)

        def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
            out: Tensor = self.layer(x, edge_index)
            return out

    here, apart = pair(PolicyModule("sums", Sums(), "blind_navigation_v0", 3))
    x = torch.randn(2, 3, 6)
    said = []
    for policy in (here, apart):
        with pytest.raises(NoAttentionError) as caught:
            policy.attention(x)
        said += [str(caught.value), policy.why_no_attention(x)]
    assert set(said) == {"Sums has no attention layer: choose another explainer."}


def test_an_entry_of_a_code_policy_has_the_same_values_in_one_process(tmp_path: Path) -> None:
    quick: dict[str, Any] = {"episodes": 2, "timesteps": 2, "max_cycles": 2, "behaviour_episodes": 1}
    apart = score(with_memory(), "gradient", **quick)
    here = score(with_memory(), "gradient", isolate=False, cache=tmp_path / "cache", **quick)
    assert apart.results == here.results
    assert (apart.policy.isolated, here.policy.isolated) == (None, False)
    assert apart.policy.model_copy(update={"isolated": False}) == here.policy
    opened = open_module(with_memory(), origin_of(nn.Module()))
    assert score(opened, "gradient", **quick).results == here.results
    assert not (tmp_path / "cache").exists()


HOSTILE = """
import os, sys

import torch

from tests.bench.checks.test_policy_checks import Pilot
from xmarl_bench import PolicyModule

class Acts(Pilot):
    "Does harm once it is measured: in large batches."

    def __init__(self, act):
        super().__init__()
        self.act = act

    def forward(self, x, edge_index):
        if len(x) > 60:
            self.act()
        return super().forward(x, edge_index)

class Stop(BaseException):
    pass

def stop():
    raise Stop("now")

def made(name, act):
    return PolicyModule(name, Acts(act), "blind_navigation_v0", 3)

def vandal():
    import xmarl_bench.metrics as metrics
    from xmarl_bench.scoring.states import States

    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(7)
    for name in list(vars(metrics)):
        if callable(getattr(metrics, name)) and name.islower():
            setattr(metrics, name, lambda *_, **__: 1.0)
    States.with_inverse = States.mask_metrics = lambda *_: 1 / 0
    torch.Tensor.argmax = lambda self, *_, **__: torch.zeros(())
    os.chdir("/")
    print("noise")
    sys.stderr.write("noise")
    torch.set_default_dtype(torch.float32)
    return made("vandal", lambda: None)

def crashes():
    return made("crashes", lambda: os._exit(7))

def stops():
    return made("stops", stop)

def leaves():
    sys.exit(9)
"""


def test_hostile_policies_in_a_sweep_change_no_other_entry(
    make_bundle: MakeBundle, tmp_path: Path, run_cli: RunCli
) -> None:
    bundle = make_bundle()
    (tmp_path / "mine.py").write_text(HOSTILE)
    names = ("vandal", "crashes", "stops", "leaves")
    hostile = [part for name in names for part in ("--policy", f"{tmp_path}/mine.py:{name}")]

    def scored(*more: object) -> tuple[dict[str, Entry], int, str]:
        folder = tmp_path / f"out{len(more)}"
        ran = run_cli(
            "score", *more, "--policy", bundle, "--explainer", "occlusion", "--episodes", 3, "--timesteps", 3,
            "--max-cycles", 6, "--behaviour-episodes", 1, "--out", folder,
            "--cache", tmp_path / f"cache{len(more)}",
        )  # fmt: skip
        return {each.policy.name: each for _, each in read_entries(folder / "entries")}, ran.code, ran.err

    alone, code_alone, _ = scored()
    beside, code_beside, errors = scored(*hostile, "--trust-code")
    assert (code_alone, code_beside) == (0, 1)
    assert alone["small"].entry_id == beside["small"].entry_id
    assert beside.keys() == {"small", "vandal"}
    for said in (
        r"failed: occlusion on crashes: the process of policy mine.py:crashes ended \(exit code 7\)",
        r"failed: occlusion on stops: policy mine.py:stops failed \(Stop: now\): correct it",
        r"failed: .*mine.py:leaves' could not be made \(SystemExit: 9\)",
    ):
        assert re.search(said, errors), errors
    assert "noise" not in errors
    assert beside["vandal"].policy.trusted_code
    assert beside["vandal"].policy.isolated is None


def test_choices_that_would_end_the_physics_are_refused() -> None:
    class Lost(TwoLayers):
        def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
            return super().forward(x, edge_index)[:, :4] + torch.where(x[:, :1] == 7.0, torch.nan, 0.0)

    policy, _ = isolate_policy(PolicyModule("lost", Lost(), "blind_navigation_v0", 3), Isolation())
    x = torch.full((1, 3, 6), 7.0)
    with pytest.raises(InputError, match="policy lost chose actions that are NaN or infinite"):
        step_teams(policy)(x, None)


WIDE = torch.arange(60.0).view(5, 3, 4)


@pytest.mark.parametrize(
    "tensor",
    [
        WIDE, WIDE[1:], WIDE[:, :, 1:3], WIDE[:1].expand(7, 3, 4), WIDE.transpose(0, 2), WIDE[:, :0],
        WIDE[0, 0, 1],
    ],
)  # fmt: skip
def test_tensors_arrive_with_their_strides_and_alignment(tensor: Tensor) -> None:
    sent = Sent.of(tensor)
    layout = json.loads(json.dumps(sent.layout))
    for again in (sent.tensor(), Sent.parse(layout, tuple(tensor.shape), sent.data + b"more").tensor()):
        assert torch.equal(again, tensor)
        assert again.stride() == tensor.stride()
        assert not tensor.numel() or again.data_ptr() % 64 == tensor.data_ptr() % 64


def test_an_axis_of_equal_entries_is_sent_once_and_numbers_that_overlap_are_sent_apart() -> None:
    assert len(Sent.of(WIDE[:1].expand(7, 3, 4)).data) == 4 * 12
    overlapping = torch.arange(6.0).as_strided((3, 3), (1, 1))
    assert torch.equal(Sent.of(overlapping).tensor(), overlapping)


@pytest.mark.parametrize(
    "layout", [None, [], [[4, 1], 16], [[1, 1], 0], [[-4, 1], 0], [[4], 0], [[2**40, 1], 0], [["4", 1], 0]]
)
def test_answers_that_are_no_tensor_are_refused(layout: object) -> None:
    with pytest.raises(ValueError, match=r"layout|expected shape"):
        Sent.parse(layout, (2, 4), bytes(32))
    assert torch.equal(Sent.parse([[4, 1], 3], (2, 4), bytes(40)).tensor(), torch.zeros(2, 4))
    with pytest.raises(ValueError, match="expected shape"):
        Sent.parse([[4, 1], 0], (2, 4), bytes(31))


def test_a_wrapped_network_is_taken_out() -> None:
    network = TwoLayers()
    for wrapped in (nn.DataParallel(network), torch.compile(network)):
        assert PolicyModule("p", wrapped, "blind_navigation_v0", 3).network is network  # type: ignore[arg-type]


def test_a_network_that_cannot_be_opened_is_refused_in_one_sentence() -> None:
    parametrised = TwoLayers()
    nn.utils.parametrizations.weight_norm(next(m for m in parametrised.modules() if isinstance(m, nn.Linear)))
    for network, said in (
        (parametrised, "call torch.nn.utils.parametrize.remove_parametrizations, or run it here"),
        (GATv2Conv(-1, 4), "has no shape yet: run the network once"),
    ):
        with pytest.raises(InputError, match=said):
            isolate_policy(PolicyModule("p", network, "blind_navigation_v0", 3), Isolation())


def test_what_cannot_be_sent_is_refused_in_one_sentence() -> None:
    class Locked(TwoLayers):
        def __init__(self) -> None:
            super().__init__()
            self.lock = os.scandir(".")

    with pytest.raises(InputError, match=r"'locked' cannot be sent to a process of its own \(TypeError"):
        isolate_policy(PolicyModule("locked", Locked(), "blind_navigation_v0", 3), Isolation())
