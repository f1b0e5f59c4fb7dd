"""A policy travels with each piece of its work and is loaded once in a process."""

from __future__ import annotations

import pickle
from pathlib import Path

import cloudpickle
import pytest
import torch

from tests.helpers import units_of_work
from tests.helpers.policies import small_policy
from xmarl_bench.parallel.fan_out import in_order
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.policy import Policy
from xmarl_bench.scoring.policy_payload import POLICIES_KEPT, PolicyPayload

Work = tuple[Policy, str]


def there(payload: PolicyPayload[Work]) -> Work:
    """As a worker finds it."""
    arrived: PolicyPayload[Work] = pickle.loads(cloudpickle.dumps(payload))
    return arrived.work


def work(policy: Policy, rest: str) -> PolicyPayload[Work]:
    return PolicyPayload((policy, rest), policy)


def test_one_policy_for_all_pieces_with_the_same_weights() -> None:
    policy = small_policy(6)
    first, one = there(work(policy, "one"))
    second, two = there(work(policy, "two"))
    assert (one, two) == ("one", "two")
    assert first is second
    assert first is not policy
    observations = torch.zeros(1, 3, 6)
    assert torch.equal(first.distribution(observations).action, policy.distribution(observations).action)


def test_a_policy_that_was_changed_is_another_one() -> None:
    policy = small_policy(6)
    before, _ = there(work(policy, ""))
    with torch.no_grad():
        next(policy.parameters()).add_(1.0)
    after, _ = there(work(policy, ""))
    assert after is not before
    assert torch.equal(next(after.parameters()), next(policy.parameters()))


def test_few_are_kept() -> None:
    policies = [small_policy(6, seed) for seed in range(POLICIES_KEPT + 1)]
    first, *_ = [there(work(policy, ""))[0] for policy in policies]
    again, _ = there(work(policies[0], ""))
    assert again is not first


def test_in_this_process_nothing_is_copied() -> None:
    policy = small_policy(6)
    assert work(policy, "").work[0] is policy


@pytest.mark.slow
def test_each_worker_loads_it_once(tmp_path: Path) -> None:
    policy = small_policy(6)
    units = [work(policy, str(tmp_path)) for _ in range(12)]
    loaded = list(in_order(units_of_work.loaded, units, workers=Workers(2)))
    assert len(loaded) == 12
    processes = {process for process, _ in loaded}  # two, and those that loky replaced one with
    assert 2 <= len(processes) < 12
    assert len(set(loaded)) == len(processes)
