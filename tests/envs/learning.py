"""PPO of stable-baselines3 on any VecEnv with one entry per agent of blind navigation."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecEnv, VecMonitor
from xmarl_envs import make_task
from xmarl_envs.sb3_vec_env import AgentVecEnv

N_AGENTS, MAX_CYCLES = 3, 100


def distances_before_and_after_learning(env: VecEnv) -> tuple[float, float]:
    """Distances (m) of agents from their goals at the end of episodes, before and after 8,000 team-steps.

    They start about 1.2 m away. (Returns are less clear: two agents in contact lose a point per step.)
    """
    model = PPO(
        "MlpPolicy",
        VecMonitor(env),
        n_steps=64,
        batch_size=512,
        n_epochs=4,
        learning_rate=3e-3,
        gamma=0.95,
        seed=0,
        device="cpu",
    )
    before = mean_last_distance(model)
    model.learn(8_000 * N_AGENTS)
    return before, mean_last_distance(model)


def mean_last_distance(model: PPO) -> float:
    """m, over 20 deterministic episodes."""
    distances = []

    def collect(local: dict[str, Any], _: dict[str, Any]) -> None:
        if local["done"]:
            distances.append(np.linalg.norm(local["info"]["terminal_observation"][4:6]))

    discrete = isinstance(model.action_space, spaces.Discrete)
    task = make_task("blind_navigation_v0", N_AGENTS, continuous_actions=not discrete)
    env = VecMonitor(AgentVecEnv(task, 20, seed=10_000, max_cycles=MAX_CYCLES))
    evaluate_policy(model, env, n_eval_episodes=env.num_envs, callback=collect)
    assert len(distances) == env.num_envs
    return float(np.mean(distances))
