"""Rolls out JaxMARL's simple_spread: `jaxmarl_peer.py EPISODES scan|loop CYCLES HELD`.

Prints `seconds` and a number: CPU seconds of compiling and the first rollout, then of one rollout for each
line. Needs jaxmarl, which prints messages too, and nothing of this project.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jaxmarl
from jax import numpy as jnp

Batch = Any  # a pytree of arrays


def rollout(n_episodes: int, way: str, cycles: int, held: int) -> Callable[[], None]:
    """Random actions, each held for some cycles; episodes begin anew when they end.

    The scan keeps rewards and one sum of each observation, so that none of them is optimised away.
    """
    env = jaxmarl.make("MPE_simple_spread_v3", num_agents=3, action_type="Continuous", max_steps=cycles)
    key, drawing = jax.random.split(jax.random.PRNGKey(0))
    drawn = jax.random.uniform(drawing, (cycles // held, n_episodes, 3, 5))
    actions = jnp.repeat(drawn, held, axis=0)
    keys = jax.random.split(key, (cycles, n_episodes))

    def step(state: Batch, key: Batch, action: Batch) -> tuple[Batch, Batch, Batch]:
        observation, state, reward, _, _ = env.step(key, state, dict(zip(env.agents, action, strict=True)))
        return state, observation, reward

    def reset(key: Batch) -> Batch:
        return env.reset(key)[1]

    if n_episodes == 1:  # fastest without a batch
        keys, actions = keys[:, 0], actions[:, 0]
    else:
        step, reset = jax.vmap(step), jax.vmap(reset)
    start = jax.jit(reset)(keys[0])

    def scanned(state: Batch, given: Batch) -> tuple[Batch, Batch]:
        state, observation, reward = step(state, *given)
        return state, ([each.sum(-1) for each in observation.values()], list(reward.values()))

    whole = jax.jit(lambda state, keys, actions: jax.lax.scan(scanned, state, (keys, actions)))
    if way == "scan":
        return lambda: jax.block_until_ready(whole(start, keys, actions))
    compiled, each_key, each_action = jax.jit(step), list(keys), list(actions)

    def loop() -> None:
        state = start
        for key, action in zip(each_key, each_action, strict=True):
            state, observation, reward = compiled(state, key, action)
        jax.block_until_ready((state, observation, reward))

    return loop


def main() -> None:
    n_episodes, way, cycles, held = sys.argv[1:]
    run = rollout(int(n_episodes), way, int(cycles), int(held))
    while True:
        started = time.process_time()
        run()
        print("seconds", time.process_time() - started, flush=True)
        if not sys.stdin.readline():
            return


if __name__ == "__main__":
    main()
