"""PettingZoo's own tests, as promises of an environment."""

from __future__ import annotations

import contextlib
import traceback
import warnings
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

from pettingzoo.test import (
    api_test,
    max_cycles_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
    seed_test,
)
from pettingzoo.test.state_test import state_test
from pettingzoo.utils import BaseParallelWrapper, parallel_to_aec

EPISODES_TRIED = 20  # to find one that lasts for all cycles
Make = Callable[..., Any]  # a ParallelEnv's constructor with its options bound


@contextlib.contextmanager
def promise(name: str, what: str) -> Iterator[None]:
    """Turn whatever is raised inside into an AssertionError that names what was promised.

    Warnings of PettingZoo's tests are errors: they report most faults only so. An assertion without a message
    is quoted.
    """
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", category=UserWarning, module=r"pettingzoo\.")
            warnings.filterwarnings("ignore", message=".*(minimum|maximum).*space value.*infinity.*")
            yield
    except Exception as error:
        said = str(error).strip().splitlines()
        how = said[0].rstrip(".") if said else traceback.extract_tb(error.__traceback__)[-1].line
        kind = "" if isinstance(error, AssertionError) else f"{type(error).__name__}: "
        raise AssertionError(f"{name} breaks the promise that {what}: {kind}{how}.") from error


def check_pettingzoo(name: str, make: Make, renders: bool, seed: int) -> None:
    """Raise an AssertionError if a test of PettingZoo fails. renders: the environment can draw itself."""

    def make_aec(**options: Any) -> Any:
        return parallel_to_aec(make(**options))

    tests: dict[str, Callable[[], object]] = {
        "parallel_api_test": lambda: parallel_api_test(make(), num_cycles=300),
        "api_test when stepped turn by turn": lambda: api_test(make_aec(), num_cycles=300),
        "parallel_seed_test": lambda: parallel_seed_test(make, num_cycles=500),
        "seed_test": lambda: seed_test(make_aec, num_cycles=500),
        "max_cycles_test": lambda: _max_cycles_test(make, seed),
        "state_test": lambda: state_test(make_aec(), make()),
    }
    if renders:
        tests["render_test"] = lambda: render_test(make_aec)
    for what, test in tests.items():
        with promise(name, f"it passes PettingZoo's {what} without a warning"):
            test()


def _max_cycles_test(make: Make, seed: int) -> None:
    """Run PettingZoo's `max_cycles_test` on seeded episodes until one passes.

    It fails on an episode that ends before `max_cycles`; without seeds that would happen by chance.
    """

    class Seeded(BaseParallelWrapper):  # type: ignore[misc]  # no py.typed in pettingzoo
        def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
            return self.env.reset(seed=episode if seed is None else seed, options=options)

    def parallel_env(**options: Any) -> Seeded:
        env = Seeded(make(**options))
        env.reset()  # some have no agents before
        for k, agent in enumerate(env.possible_agents):
            env.action_space(agent).seed(episode + k)
        return env

    def env(**options: Any) -> Any:
        return parallel_to_aec(parallel_env(**options))

    for episode in range(seed, seed + EPISODES_TRIED):
        try:
            max_cycles_test(SimpleNamespace(parallel_env=parallel_env, env=env))
            return
        except AssertionError:
            if episode + 1 == seed + EPISODES_TRIED:
                raise
