"""An explainer that plays on is scored as any other, in the world of each episode, and verified again."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.conftest import MakeBundle
from xmarl_bench import as_explainer, load_policy, score
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.policy import Policy
from xmarl_bench.submission.rerun import rerun

pytestmark = pytest.mark.slow


def next_places(observations: Tensor, policy: Policy, simulator: Simulator) -> Tensor:
    """The nearer a sender will be in three steps, the higher; fails where it is not in its own episode."""
    env = simulator.restart(policy, observations)
    torch.testing.assert_close(torch.from_numpy(env.observe()), observations, atol=1e-6, rtol=0)
    for _ in range(3):
        env.step(policy.distribution(torch.from_numpy(env.observe())).action.detach().numpy())
    position = torch.from_numpy(env.state.position).float()
    return torch.exp(-torch.cdist(position, position))


@pytest.fixture(scope="module")
def explainer() -> Explainer:
    return as_explainer(next_places, stochastic=True)


def test_it_is_scored_and_verified_in_the_world_of_each_episode(
    explainer: Explainer, make_bundle: MakeBundle
) -> None:
    policy, card = load_policy(make_bundle())
    entry = score((policy, card), explainer, episodes=3, timesteps=4, max_cycles=9, behaviour_episodes=2)
    (result,) = entry.results
    assert entry.explainer.accesses == "simulator"
    assert result.metrics.weight_randomisation is not None
    assert result.behaviour_episodes == 0
    assert result.not_measured["behavioural_fidelity"].startswith("the explainer plays on in recorded")
    for episodes in (2, None):
        again = rerun(entry, policy, card, explainer, episodes=episodes, rng=np.random.default_rng(0))
        assert again.findings == []
        assert len(again.episodes) == (episodes or 3)
        assert max(each.size for each in again.differences) == 0.0
