"""A caller's settings of torch do not change an entry, and are the caller's again afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import pytest
import torch
from torch import nn

from tests.bench.scoring.test_score import bytes_of
from tests.conftest import MakeBundle
from tests.helpers.gatv2 import OneLayer
from xmarl_bench.errors import InputError
from xmarl_bench.origin.references import origin_of
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.policy import load_policy
from xmarl_bench.policy.policy_module import PolicyModule
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.evaluation import evaluate
from xmarl_bench.scoring.score import score


@contextmanager
def default_dtype() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


Settings = Callable[[], AbstractContextManager[object]]
SETTINGS: dict[str, Settings] = {
    "inference_mode": torch.inference_mode,
    "no_grad": torch.no_grad,
    "default dtype": default_dtype,
    "default device": lambda: torch.device("meta"),
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
}


def settings() -> tuple[object, ...]:
    return (
        torch.is_inference_mode_enabled(), torch.is_grad_enabled(), torch.get_default_dtype(),
        torch.get_default_device(), torch.is_autocast_enabled("cpu"),
    )  # fmt: skip


def entry_bytes(make_bundle: MakeBundle, inside: Settings) -> bytes:
    """Of a policy that is loaded and scored with these settings."""
    folder = make_bundle()
    with inside():
        before = settings()
        entry = score(load_policy(folder), "gradient", episodes=1, timesteps=2, max_cycles=4)
        assert settings() == before
    return bytes_of(entry)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    from tests.conftest import save_bundle

    return entry_bytes(lambda: save_bundle(tmp_path_factory.mktemp("policies")), nullcontext)


@pytest.mark.slow
@pytest.mark.parametrize("inside", SETTINGS.values(), ids=SETTINGS)
def test_the_entry_is_the_same(inside: Settings, expected: bytes, make_bundle: MakeBundle) -> None:
    assert entry_bytes(make_bundle, inside) == expected


@pytest.mark.parametrize("inside", SETTINGS.values(), ids=SETTINGS)
def test_policies_perform_the_same(inside: Settings, make_bundle: MakeBundle) -> None:
    folder, cell, sampling = make_bundle(), Cell("blind_navigation_v0", 3), Sampling(episodes=1, max_cycles=4)
    plain = evaluate([(load_policy(folder)[0], cell)], sampling)
    with inside():
        assert evaluate([(load_policy(folder)[0], cell)], sampling) == plain


def made_in_inference_mode() -> nn.Module:
    with torch.inference_mode():
        return OneLayer()


def with_a_sparse_tensor() -> nn.Module:
    network = OneLayer()
    network.register_buffer("neighbours", torch.eye(3).to_sparse())
    return network


class Counts(OneLayer):
    def get_extra_state(self) -> dict[str, int]:
        return {"episodes": 3}

    def set_extra_state(self, state: object) -> None: ...


def module(network: nn.Module) -> PolicyModule:
    return PolicyModule("mine", network, task="blind_navigation_v0", n_agents=3)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: OneLayer().double(), r"is float64: convert it with .float\(\)."),
        (lambda: OneLayer().half(), r"is float16: convert it with .float\(\)."),
        (lambda: OneLayer().to("meta"), r'is on meta: move the network with .to\("cpu"\).'),
        (
            made_in_inference_mode,
            "was made in torch.inference_mode: make the network outside",
        ),
        (with_a_sparse_tensor, r"has layout sparse_coo: make it dense with .to_dense\(\)."),
    ],
)
def test_networks_that_cannot_be_scored_are_refused(make: Callable[[], nn.Module], said: str) -> None:
    with pytest.raises(InputError, match=f"of policy 'mine' {said}"):
        score(module(make()), "attention", episodes=1, max_cycles=2)


def test_a_state_beside_the_tensors_is_refused() -> None:
    """Two networks with equal weights would count as one policy."""
    with pytest.raises(InputError, match=r"policy 'mine' keeps a dict in '_extra_state' \(get_extra_state\)"):
        score(module(Counts()), "attention", episodes=1, max_cycles=2)


def test_buffers_that_are_not_saved_count_for_the_hash_of_the_weights() -> None:
    networks = [OneLayer(), OneLayer(), OneLayer()]
    for network, scale in zip(networks, (1.0, 1.0, 2.0), strict=True):
        network.load_state_dict(networks[0].state_dict())
        network.register_buffer("scale", torch.tensor(scale), persistent=False)
    one, same, other = (
        open_module(module(network), origin_of(network))[1].weights_sha256 for network in networks
    )
    assert one == same != other


def test_policies_changed_after_loading_are_refused(make_bundle: MakeBundle) -> None:
    policy, card = load_policy(make_bundle())
    with pytest.raises(InputError, match="of policy 'small' is float64"):
        score((policy.double(), card), "attention", episodes=1, max_cycles=2)
