"""Plays seeded episodes and hashes every bit of them; also a script, so that other processes can be asked.

`python trajectory.py` prints one line per task: its name and the hash of one episode.
"""

from __future__ import annotations

import hashlib

import numpy as np
from xmarl_envs import TASKS, VectorEnv, make_task

N_AGENTS, SEED = 5, 12


def play(env: VectorEnv, seed: int, slot: int = 0, meddling: bool = False) -> tuple[str, int]:
    """One whole episode in `slot` of the batch: the hash of its observations and rewards, and its contacts.

    The team pushes at random and to the middle of its goals (discovery: away from the landmark, for the
    episode to last), so that agents and walls are touched.
    meddling: the other slots play other episodes, begin anew at odd moments, and drop out.
    """
    digest = hashlib.sha256()
    rng = np.random.default_rng([seed, 1])
    other_rng = np.random.default_rng([seed, slot, 2])
    others = [k for k in range(env.n_episodes) if k != slot]
    observation = env.reset([seed if k == slot else 1000 + k for k in range(env.n_episodes)])
    digest.update(observation[slot].tobytes())
    targets = env.state.targets[slot]
    meeting = targets.mean(axis=0) if len(targets) == env.task.n_agents else -targets[0]
    n_contacts = 0
    while True:
        action = other_rng.uniform(-1, 1, (env.n_episodes, env.task.n_agents, 2))
        pull = meeting - env.state.position[slot]
        action[slot] = 2 * pull + rng.uniform(-1, 1, (env.task.n_agents, 2))
        live = np.ones(env.n_episodes, dtype=np.bool_)
        if meddling and others:
            live[others] = other_rng.random(len(others)) < 0.9
        step = env.step(action, live)
        digest.update(step.observation[slot].tobytes())
        digest.update(step.reward[slot].tobytes())
        n_contacts += int((step.agent_collision[slot] | step.object_collision[slot]).sum())
        if step.terminated[slot] or step.truncated[slot]:
            return digest.hexdigest(), n_contacts
        if meddling and others and other_rng.random() < 0.05:
            other = int(other_rng.choice(others))
            env.reset([int(other_rng.integers(1000))], [other])


def main() -> None:
    for name in TASKS:
        print(name, play(VectorEnv(make_task(name, N_AGENTS)), SEED)[0])


if __name__ == "__main__":
    main()
