"""The control without communication: independent PPO by SuperSuit and stable-baselines3.

SuperSuit makes a vector of agents of the PettingZoo environment. Stable-baselines3's PPO with its default MLP
policy and hyperparameters trains one network that every agent runs on its own observation (de Witt et al.
2020, "Is Independent Learning All You Need in the StarCraft Multi-Agent Challenge?"). It shows how far a team
gets without messages.

    python -m xmarl_baselines.independent_ppo --task blind_discovery_v0

writes baselines/xmarl_baselines/controls/TASK.json, shown in baselines/README.md.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import torch
import typer
from stable_baselines3 import PPO
from torch import Tensor, nn
from xmarl_envs import TaskParallelEnv, make_task
from xmarl_envs.sb3_vec_env import SuperSuitVecEnv

from xmarl_baselines.reference import EPISODES
from xmarl_bench.cli.program import run_function
from xmarl_bench.policy import ActionDistribution, Policy
from xmarl_bench.records.files import write_json
from xmarl_bench.reproducible import one_thread
from xmarl_bench.rollout.evaluation import evaluate_policy

CONTROLS = Path(__file__).parent / "controls"
COPIES = 32  # teams side by side


class IndependentPolicy(Policy):
    """An SB3 actor that every agent runs on its own observation. Masks change nothing."""

    row_wise = True

    def __init__(self, model: PPO) -> None:
        super().__init__()
        # Only the layers: SB3's policy keeps its last distribution and therefore cannot be copied.
        self.mean = nn.Sequential(model.policy.mlp_extractor.policy_net, model.policy.action_net)

    def act(self, x: Tensor, edge_index: Tensor, weight: Tensor | None = None) -> Tensor:
        return self.distribution(x).action

    def prepare(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, 2): the mean of SB3's Normal, clipped to the action space as SB3 does."""
        mean: Tensor = self.mean(observation)
        return mean.clamp(-1.0, 1.0)

    def decode(self, prepared: Tensor, mask: Tensor | None = None) -> ActionDistribution:
        largest = 1.0 - torch.finfo(prepared.dtype).eps
        loc = torch.atanh(prepared.clamp(-largest, largest))
        if mask is not None:
            loc = loc.broadcast_to(torch.broadcast_shapes(loc.shape, (*mask.shape[:-1], loc.shape[-1])))
        return ActionDistribution(loc, torch.ones_like(loc))

    def attention(self, observation: Tensor) -> Tensor:
        """Every agent listens to itself only."""
        n_agents = observation.shape[-2]
        return torch.eye(n_agents).expand(*observation.shape[:-2], n_agents, n_agents)


def train(task: str, n_agents: int, frames: int, seed: int) -> PPO:
    """SB3's PPO on SuperSuit's vector of agents, for `frames` team-steps."""
    import supersuit  # in the `dev` extra; only this control needs it

    vector = supersuit.pettingzoo_env_to_vec_env_v1(TaskParallelEnv(make_task(task, n_agents)))
    env = SuperSuitVecEnv(supersuit.concat_vec_envs_v1(vector, COPIES, num_cpus=0, base_class="gymnasium"))
    steps = 12_288 // (COPIES * n_agents)
    model = PPO("MlpPolicy", env, n_steps=steps, batch_size=1024, seed=seed, device="cpu")
    return model.learn(frames * n_agents)


def main(
    task: Annotated[str, typer.Option(help="blind_navigation_v0, blind_passage_v0 or blind_discovery_v0")],
    agents: Annotated[int, typer.Option(help="team size N")] = 3,
    frames: Annotated[int, typer.Option(min=1, help="team-steps")] = 1_000_000,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    episodes: Annotated[int, typer.Option(min=1)] = EPISODES,
    out: Annotated[Path, typer.Option(help="folder for TASK.json")] = CONTROLS,
) -> None:
    """Train the control on one task, measure it like the reference policies, and write its record."""
    started = time.monotonic()
    with one_thread():
        model = train(task, agents, frames, seed)
        seconds = time.monotonic() - started
        performance = evaluate_policy(IndependentPolicy(model).eval(), task, agents, episodes=episodes)
    record: dict[str, Any] = {
        "name": f"independent PPO, {task}, N = {agents}",
        "command": f"python -m xmarl_baselines.independent_ppo --task {task} --agents {agents} "
        f"--frames {frames} --seed {seed}",
        "frames": frames,
        "seconds": round(seconds, 1),
        "performance": performance,
    }
    write_json(out / f"{task}.json", record)
    print(f"{out / f'{task}.json'}: success {performance['with_messages']['success_rate']:.2f}")


if __name__ == "__main__":
    run_function(main)
