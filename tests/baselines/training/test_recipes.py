"""Networks equal the paper's table, recipes have the stated values, and invalid ones are refused."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any

import pytest
from xmarl_baselines.training.families import FAMILIES, Family, architecture
from xmarl_baselines.training.recipes import RECIPES, Recipe, recipe_for
from xmarl_baselines.training.shaping import Shaping
from xmarl_baselines.training.trainer import Run
from xmarl_envs import TASKS

from tests.baselines.training.small_runs import small
from xmarl_bench.errors import InputError
from xmarl_bench.policy import Architecture

# Kailas et al. (ICML 2025), section "Tasks": encoder, its activation; width of the layer, its activation;
# decoder, its activation.
TABLE: dict[str, tuple[Any, ...]] = {
    "blind_navigation_v0": ((), None, 32, "tanh", (256, 256), "tanh"),
    "blind_passage_v0": ((32,) * 4, "relu", 32, "tanh", (64,) * 4, "relu"),
    "blind_discovery_v0": ((64,), "relu", 64, "relu", (64,) * 2, "relu"),
}


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("task", TASKS)
def test_a_familys_network_is_that_of_the_table(task: str, family: Family) -> None:
    record = Architecture.model_validate({**architecture(task, family), "obs_dim": 6})
    assert TABLE[task] == (
        record.encoder,
        record.encoder_activation if record.encoder else None,
        record.gat_width,
        record.gat_activation,
        record.decoder,
        record.decoder_activation,
    )
    assert record.residual is (family == "residual")
    assert recipe_for(task, family=family).architecture == architecture(task, family)


def test_every_task_has_a_recipe_of_the_first_family() -> None:
    assert set(RECIPES) == set(TABLE) == set(TASKS)
    assert {recipe.family for recipe in RECIPES.values()} == {FAMILIES[0]} == {"residual"}


def test_family_paper_has_penalties_and_epochs_of_its_own() -> None:
    navigation, passage, discovery = (recipe_for(task, family="paper") for task in RECIPES)
    assert navigation == replace(recipe_for("blind_navigation_v0"), family="paper")
    assert (passage.shaping.agent_penalty, recipe_for("blind_passage_v0").shaping.agent_penalty) == (3.0, 6.0)
    assert discovery.n_epochs == 2 * recipe_for("blind_discovery_v0").n_epochs
    assert recipe_for("blind_passage_v0", family="paper", shaping=Shaping()).shaping == Shaping()


def test_larger_teams_change_the_recipe_of_their_family() -> None:
    navigation = [recipe_for("blind_navigation_v0", n).frames for n in (3, 4, 5, 8)]
    assert navigation == [4_800_000, 7_200_000, 9_600_000, 9_600_000]
    three, four, five = (recipe_for("blind_passage_v0", n) for n in (3, 4, 5))
    assert (three.shaping.time_penalty, three.shaping.arrival_bonus) == (0.0, 0.0)
    assert (five.shaping.time_penalty, five.shaping.arrival_bonus) == (0.2, 20.0)
    assert (three.saturation_penalty, five.saturation_penalty) == (0.0, 0.1)
    assert [recipe.caution_growth for recipe in (three, four, five)] == [2.0, 3.0, 1.0]
    assert four == replace(five, caution_growth=3.0)
    for task in ("blind_passage_v0", "blind_discovery_v0"):
        assert len({str(recipe_for(task, n, family="paper")) for n in (2, 3, 4, 5)}) == 1
    paper = [recipe_for("blind_navigation_v0", n, family="paper") for n in (3, 4, 5, 8)]
    assert [recipe.shaping.time_penalty for recipe in paper] == [0.0, 0.02, 0.02, 0.02]
    assert [recipe.batch_size for recipe in paper] == [900, 300, 300, 300]
    assert [recipe.frames for recipe in paper] == [4_800_000, 4_800_000, 7_200_000, 7_200_000]
    assert recipe_for("blind_passage_v0", 5, frames=64, batch_size=8).frames == 64


def test_names_of_runs_state_their_settings() -> None:
    recipe = recipe_for("blind_navigation_v0")
    assert Run(recipe).name == "navigation-n3-residual-lambda0-seed0"
    paper = recipe_for("blind_passage_v0", family="paper")
    assert Run(paper, 5, 0.05, seed=2).name == "passage-n5-paper-lambda0.05-seed2"
    cautious = Run(recipe, caution=2.0)
    assert cautious.name == "navigation-n3-residual-lambda0-caution2-seed0"
    assert Run.from_settings(cautious.settings()) == cautious


@pytest.mark.parametrize("task", TASKS)
def test_a_card_gives_its_recipe_back(task: str) -> None:
    recipe = recipe_for(task)
    record = json.loads(json.dumps(asdict(recipe)))
    assert Recipe.from_dict(record) == recipe
    with pytest.raises(InputError, match=r"unknown fields \(teacher\)"):
        Recipe.from_dict({**record, "teacher": "heuristic"})


def test_caution_multiplies_the_penalties_of_touching_and_of_being_near() -> None:
    shaping = Shaping(agent_penalty=0.2, proximity_penalty=0.1).with_caution(3.0)
    assert (shaping.agent_penalty, shaping.proximity_penalty) == pytest.approx((0.6, 0.3))
    assert Shaping().with_caution(3.0) == Shaping()


def test_fine_tuning_takes_a_third_of_the_frames_and_the_final_caution() -> None:
    recipe = small(caution_growth=0.5, shaping=Shaping(agent_penalty=0.4), learning_rate=3e-4)
    tuned = recipe.fine_tuning()
    assert (tuned.frames, tuned.caution_growth, tuned.shaping.agent_penalty) == (160, 1.0, 0.2)
    assert (tuned.attention_start, tuned.attention_ramp) == (0.0, 0.5)
    assert tuned.learning_rate == pytest.approx(1e-4)


def test_the_learning_rate_falls_to_a_tenth() -> None:
    recipe = small(learning_rate=1e-3)
    rates = [recipe.learning_rate_at(remaining) for remaining in (1.0, 0.5, 0.0, -0.1)]
    assert rates == pytest.approx([1e-3, 5.5e-4, 1e-4, 1e-4])


def test_bad_recipes_are_refused() -> None:
    with pytest.raises(InputError, match="no training recipe"):
        recipe_for("blind_chess_v0")
    with pytest.raises(InputError, match="no family is called 'wide'"):
        recipe_for("blind_passage_v0", family="wide")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="batch_size must be from 1 to"):
        small(batch_size=10_000)
    with pytest.raises(InputError, match=r"start at 0\.8 or before"):
        small(attention_start=0.9)
    with pytest.raises(InputError, match="no reference network"):
        architecture("blind_chess_v0", "paper")
    with pytest.raises(InputError, match="choose residual or paper"):
        architecture("blind_passage_v0", "large")  # type: ignore[arg-type]
