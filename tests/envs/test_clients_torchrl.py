"""TorchRL: its PettingZooWrapper steps a task like the ParallelEnv, infos and state included."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from pettingzoo.utils import parallel_to_aec
from xmarl_envs import TASKS, TaskParallelEnv, make_task
from xmarl_envs.info_at_reset import InfoAtReset

pytestmark = pytest.mark.slow  # TorchRL takes a second to import, so tests import it inside
tasks = pytest.mark.parametrize("name", TASKS)
both_actions = pytest.mark.parametrize("continuous", [True, False], ids=["box", "discrete"])


@pytest.fixture(autouse=True)
def torchrl_s_remark_on_pettingzoo_s_version() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="PettingZoo in TorchRL is tested using version")
        yield


def wrapped(env: Any, **options: bool) -> Any:
    from torchrl.envs import PettingZooWrapper

    return PettingZooWrapper(env, **options)


def check_env_specs(env: Any) -> None:
    from torchrl.envs import utils

    utils.check_env_specs(env)


@tasks
@both_actions
def test_specs_hold_and_a_rollout_equals_the_episode(name: str, continuous: bool) -> None:
    task = make_task(name, 3, continuous_actions=continuous)
    env = wrapped(InfoAtReset(TaskParallelEnv(task, 12)), return_state=True)
    check_env_specs(env)
    assert env.group_map == {"agent": ["agent_0", "agent_1", "agent_2"]}
    peer = TaskParallelEnv(task, 12)
    env.set_seed(4)  # resets with the seed; in TorchRL the rollout below resets once more
    peer.reset(seed=4)
    rollout = env.rollout(20)
    observations, _ = peer.reset()
    assert rollout.batch_size == (12,)
    for t in range(12):
        now, after = rollout[t], rollout[t]["next"]
        same(now["agent", "observation"], observations)
        np.testing.assert_array_equal(now["state"].numpy(), peer.state())
        actions = dict(zip(peer.agents, now["agent", "action"].numpy(), strict=True))
        observations, rewards, terminations, truncations, infos = peer.step(actions)
        same(after["agent", "observation"], observations)
        same(after["agent", "reward"][:, 0], rewards)
        same(after["agent", "terminated"][:, 0], terminations)
        same(after["agent", "truncated"][:, 0], truncations)
        for key in (peer.task.success_key, "agent_collision", "object_collision"):
            same(after["agent", "info", key], {agent: float(info[key]) for agent, info in infos.items()})
    assert rollout["next", "done"][-1].item()


def same(tensor: torch.Tensor, by_agent: dict[str, Any]) -> None:
    """Asserts that (N, ...) equals one value per agent, in agent order; TorchRL computes in float32."""
    np.testing.assert_array_equal(
        tensor.numpy(), torch.as_tensor(np.stack(list(by_agent.values()))).to(tensor.dtype)
    )


@tasks
@both_actions
def test_turn_by_turn_environments_work_too(name: str, continuous: bool) -> None:
    task = make_task(name, 2, continuous_actions=continuous)
    env = wrapped(parallel_to_aec(TaskParallelEnv(task, 6)), use_mask=True)
    check_env_specs(env)
    rollout = env.rollout(40)
    assert rollout["next", "done"][-1].item()
    assert int(rollout["agent_0", "mask"].sum()) == 6


def test_a_collector_continues_over_several_episodes() -> None:
    from torchrl.collectors import Collector

    env = wrapped(TaskParallelEnv(make_task("blind_navigation_v0", 3), 10))
    collector = Collector(env, frames_per_batch=50, total_frames=50)
    (batch,) = list(collector)
    collector.shutdown()
    done = batch["next", "done"].reshape(-1)
    assert np.flatnonzero(done.numpy()).tolist() == [9, 19, 29, 39, 49]
    starts = batch["agent", "observation"].reshape(50, -1)[::10]
    assert len(torch.unique(starts, dim=0)) == 5


def test_without_info_at_reset_torchrl_drops_the_infos() -> None:
    """If TorchRL learns the keys at the first step, remove `InfoAtReset`."""
    bare = wrapped(TaskParallelEnv(make_task("blind_navigation_v0", 3), 4))
    assert ("next", "agent", "info", "at_goal") not in bare.rollout(4).keys(True)
