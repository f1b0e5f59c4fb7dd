"""Training starts from the weights that torch and torch_geometric draw with the seed in the card."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv
from xmarl_baselines.training.command import train_and_save
from xmarl_baselines.training.families import FAMILIES, Family, architecture
from xmarl_baselines.training.model_selection import plain_actor
from xmarl_baselines.training.trainer import Run, build, train
from xmarl_envs import TASKS

from tests.baselines.training.small_runs import small
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.policy import Architecture, PolicyCard, initial_policy, load_policy, save_policy


def card_of(run: Run, obs_dim: int) -> PolicyCard:
    """The fields of a card that matter for initial weights, as `xmarl-train` writes them."""
    record = architecture(run.recipe.task, run.recipe.family)
    return PolicyCard(
        name=run.name,
        task=run.recipe.task,
        n_agents=run.n_agents,
        attention_entropy=run.attention_entropy,
        family=run.recipe.family,
        training_seed=run.seed,
        initial_seed=run.seed,
        architecture=Architecture.model_validate({**record, "obs_dim": obs_dim}),
        weights_sha256="0" * 64,
    )


def drawn_by_the_libraries(task: str, family: Family, obs_dim: int, seed: int) -> list[Tensor]:
    """Parameters of torch's and torch_geometric's layers, created one after the other after the seed."""
    a = Architecture.model_validate({**architecture(task, family), "obs_dim": obs_dim})
    encoder, decoder = (obs_dim, *a.encoder), (a.gat_width, *a.decoder, 4)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        layers: list[nn.Module] = [nn.Linear(n_in, n_out) for n_in, n_out in pairwise(encoder)]
        layers.append(
            GATv2Conv(encoder[-1], a.gat_width, add_self_loops=False, residual=family == "residual")
        )
        layers += [nn.Linear(n_in, n_out) for n_in, n_out in pairwise(decoder)]
    return [parameter.detach() for layer in layers for parameter in layer.parameters()]


def same_bits(module: nn.Module, expected: list[Tensor]) -> bool:
    given = list(module.parameters())
    return len(given) == len(expected) and all(map(torch.equal, given, expected))


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("task", TASKS)
def test_training_starts_from_the_weights_that_the_libraries_draw(task: str, family: Family) -> None:
    run = Run(small(task, family=family), seed=4)
    # A run resumed at frame 160 is built with another seed.
    for seed in (run.seed, run.seed + 160):
        actor = build(run, seed=seed).policy.actor
        expected = drawn_by_the_libraries(task, family, actor.architecture.obs_dim, run.seed)
        assert same_bits(actor, expected)
        assert same_bits(initial_policy(card_of(run, actor.architecture.obs_dim)), expected)
    assert not same_bits(build(Run(small(task, family=family), seed=5), seed=5).policy.actor, expected)


def test_a_resumed_run_records_the_seed_of_its_first_weights(tmp_path: Path) -> None:
    run, folder = Run(small(), seed=7), tmp_path / "run"

    def stop_half_way(frames: int, _: dict[str, float]) -> None:
        if frames >= 320:
            raise KeyboardInterrupt

    first = plain_actor(build(run, seed=run.seed))
    with pytest.raises(KeyboardInterrupt):
        train(run, folder, checkpoint_every=1, report=stop_half_way)
    card = train_and_save(run, folder, resume=True, start_from=None, episodes=1)
    policy, loaded = load_policy(folder / "policy")
    assert loaded == card
    assert (card.initial_seed, card.family) == (7, "residual")
    before = initial_policy(loaded)
    assert same_bits(before, list(first.parameters()))
    assert not before.training
    x = random_observations(4, 3, 6)
    assert not torch.equal(before.distribution(x).loc, policy.distribution(x).loc)


def test_a_card_without_the_seed_is_refused(tmp_path: Path) -> None:
    named = {"name": "mine", "task": "blind_navigation_v0", "n_agents": 3, "attention_entropy": 0.0}
    card = save_policy(tmp_path / "mine", small_policy(6), **named)
    assert card.initial_seed is None
    with pytest.raises(InputError, match="'mine' has no seed of its initial weights: set initial_seed"):
        initial_policy(card)


def test_the_global_random_state_is_unchanged() -> None:
    card = card_of(Run(small()), 6)
    torch.manual_seed(3)
    expected = torch.rand(2)
    torch.manual_seed(3)
    initial_policy(card)
    assert torch.equal(torch.rand(2), expected)
