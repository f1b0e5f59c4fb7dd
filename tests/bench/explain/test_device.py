"""Explainers on another device than the CPU give the masks of the CPU, and an entry says the device."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from xmarl_envs import TASKS

from tests.conftest import MakeBundle
from tests.helpers.policies import small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer, on_device, run_explainer
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import Policy
from xmarl_bench.policy.device import checked_device
from xmarl_bench.scoring.score import score
from xmarl_bench.submission.tolerance import is_same_platform

ITERATE = (
    "gnn_explainer",
    "gnn_explainer-tuned",
    "graphmask",
    "gnn_explainer-messages",
    "graphmask-messages",
)
N_ENTRIES = len(TASKS["blind_navigation_v0"].observation_names)


@pytest.mark.slow
@pytest.mark.parametrize("device", ["cpu:0", "cuda"])
@pytest.mark.parametrize("name", ITERATE)
def test_masks_of_another_device_are_those_of_the_cpu(name: str, device: str) -> None:
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA device here")
    x = torch.randn(4, 3, N_ENTRIES, generator=torch.Generator().manual_seed(0))
    explainer, policy = find_explainer(name), small_policy(N_ENTRIES)
    there = on_device(explainer, device)
    assert there.device == device
    here, other = (run_explainer(each, policy, x, 1) for each in (explainer, there))
    assert other.device == torch.device("cpu")
    torch.testing.assert_close(other, here, atol=0 if device == "cpu:0" else 1e-3, rtol=0)


def test_policy_and_observations_come_on_the_device() -> None:
    """The meta device computes nothing, so everything that arrives there is seen."""
    seen: list[str] = []

    def explain(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        parameters = {each.device.type for each in policy.parameters()}
        seen.extend([observations.device.type, *parameters, generator.device.type])
        return torch.full((len(observations), 3, 3), 0.5)

    policy = small_policy(N_ENTRIES)
    for batched in (True, False):
        given = Explainer(
            "own", explain if batched else lambda *_: explain(*_)[0], batched=batched, device="meta"
        )
        run_explainer(given, policy, torch.zeros(1 if batched else 3, 3, N_ENTRIES), 0)
    assert seen == ["meta", "meta", "cpu"] * 4
    assert {each.device.type for each in policy.parameters()} == {"cpu"}


def test_an_explainer_that_does_not_declare_it_stays_on_the_cpu() -> None:
    attention = find_explainer("attention")
    assert on_device(attention, "cpu:0") is attention


@pytest.mark.parametrize(("name", "said"), [("gpu", "is not a device"), ("cuda:99", "not available")])
def test_devices_that_are_not_there_are_refused(name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        checked_device(name)


@pytest.mark.slow
def test_an_entry_says_the_device_and_keeps_the_id_of_the_cpu(make_bundle: MakeBundle) -> None:
    bundle = make_bundle()
    here, there = (
        score(
            bundle,
            "gnn_explainer",
            episodes=1,
            timesteps=1,
            max_cycles=2,
            behaviour_episodes=0,
            device=device,
        )
        for device in ("cpu", "cpu:0")
    )
    assert (here.provenance.device, there.provenance.device) == (None, "cpu:0")
    assert "device" not in here.model_dump(mode="json")["provenance"]
    assert here.entry_id == there.entry_id
    assert is_same_platform(here)
    assert not is_same_platform(there)  # compared within the tolerance
    assert there.provenance.device == "cpu:0"
