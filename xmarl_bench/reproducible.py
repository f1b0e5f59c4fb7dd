"""Makes a score a function of its arguments: seeds derived from names, never from order, and one thread."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

import numpy as np

from xmarl_bench.errors import InputError

if TYPE_CHECKING:
    import torch

# Environment seeds, in ranges that do not overlap, below 2**53, up to which readers of JSON in other
# languages keep integers exact. Explainers are fitted on seeds of the training's range, from 2**30.
SEEDS_PER_RUN = 10**6
LONGEST_VALUE: Final = 200
TRAINING_SEEDS: Final = range(2**31)
PUBLIC_SEEDS: Final = range(10**12, 10**12 + 10**9 * SEEDS_PER_RUN)  # of scoring, 10**9 runs
FRESH_SEEDS: Final = range(2**52, 2**53)  # of scoring on episodes that nobody knew at submission


def episode_seeds(seed: int, episodes: int) -> list[int]:
    """The environment seeds of a scoring run: 10^12 + seed * 10^6 + k for k = 0 .. episodes - 1.

    A run with fewer episodes plays the first ones of a longer run. Raises InputError if an argument is out of
    range.
    """
    if not 0 <= seed < 10**9:
        raise InputError(f"seed must be in [0, 10^9), got {seed}: choose a number in that range.")
    if not 1 <= episodes <= SEEDS_PER_RUN:
        raise InputError(
            f"episodes must be in [1, {SEEDS_PER_RUN}], got {episodes}: choose a number in that range."
        )
    return [PUBLIC_SEEDS[seed * SEEDS_PER_RUN + k] for k in range(episodes)]


def fresh_seeds(protocol: str, value: str, episodes: int) -> list[int]:
    """Environment seeds that depend on nothing but the protocol's id, a value and the number of the episode.

    value: fixed after a submission, a commit hash for example. Raises InputError if it is empty, too long or
    not printable.
    """
    if not value.strip() or len(value) > LONGEST_VALUE or not value.isprintable():
        raise InputError(
            f"fresh seeds are derived from 1 to {LONGEST_VALUE} printable characters, got {len(value)}: "
            f"give the hash of a commit made after the submission."
        )
    return [
        FRESH_SEEDS[derived_seed("fresh", protocol, value, k) % len(FRESH_SEEDS)] for k in range(episodes)
    ]


def derived_seed(*parts: int | str) -> int:
    """A seed in [0, 2^63) derived from names and numbers, the same in every process and Python version."""
    digest = hashlib.sha256("\x1f".join(str(part) for part in parts).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread: matrix products round differently when several threads share them."""
    import torch  # imported lazily, here and below: deriving seeds does not need torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def torch_defaults() -> Iterator[None]:
    """Run with torch's own settings, whatever the caller has set, and restore the caller's afterwards.

    These are the default dtype and device, gradients, inference mode and autocast.
    """
    import torch

    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        with (
            torch.inference_mode(False),
            torch.enable_grad(),
            torch.autocast("cpu", enabled=False),
            torch.device("cpu"),
        ):
            yield
    finally:
        torch.set_default_dtype(before)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed the global random states of torch, numpy and Python for the block, and restore them afterwards."""
    import torch

    numpy_state, python_state = np.random.get_state(), random.getstate()  # noqa: NPY002
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(seed)  # of the CPU: a hundredth of torch.manual_seed
        np.random.seed(seed % 2**32)  # noqa: NPY002
        random.seed(seed)
        try:
            yield
        finally:
            np.random.set_state(numpy_state)  # noqa: NPY002
            random.setstate(python_state)


def timestep_seeds(n_steps: int, generator: torch.Generator) -> list[int]:
    """One seed per timestep: draws for a timestep depend on no other one."""
    import torch

    seeds: list[int] = torch.randint(2**62, (n_steps,), generator=generator).tolist()
    return seeds
