"""A policy travels with each piece of its work and is loaded once in a process."""

from __future__ import annotations

import pickle

import cloudpickle
import torch

from tests.helpers.policies import small_policy
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
