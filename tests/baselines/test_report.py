"""The tables of the reference policies agree with their cards; controls and checkpoints are as described."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from xmarl_baselines import independent_ppo, ship
from xmarl_baselines.policies import HERE
from xmarl_baselines.reference import reference_runs
from xmarl_baselines.report import READMES, cell_rows, draw, filled, final, policy_rows, shipped_cards
from xmarl_baselines.training.trainer import Run

from xmarl_bench.papers.kailas2025.paper import MAIN
from xmarl_bench.policy import PolicyCard
from xmarl_bench.policy.card import load_card


@pytest.mark.parametrize("readme", READMES, ids=lambda path: path.parent.name)
def test_the_tables_are_up_to_date(readme: Path) -> None:
    text = readme.read_text(encoding="utf-8")
    assert ":begin -->" in text
    assert filled(text) == text, "run `python -m xmarl_baselines.report`"


def test_a_cell_s_row_has_best_median_and_paper() -> None:
    def card(seed: int, success: float, family: str = "residual") -> PolicyCard:
        heard = {
            "success_rate": success,
            "no_agent_collision": 0.5,
            "no_object_collision": None,
            "makespan": 9.0,
        }
        example = final(shipped_cards())[0]
        performance = {**example.performance, "with_messages": heard}
        update = {
            "name": f"x-seed{seed}",
            "task": "blind_navigation_v0",
            "n_agents": 3,
            "attention_entropy": 0.0,
            "family": family,
        }
        training = {**example.training, "validation": heard}
        return example.model_copy(update={**update, "performance": performance, "training": training})

    other, row = cell_rows([card(0, 0.7), card(1, 0.9), card(2, 0.8), card(0, 0.6, "paper")])
    assert row["success"] == "0.90 (0.80), paper 0.99"
    assert row["no wall contact"] == "-"
    assert (row["family"], row["best seed"], row["seeds"]) == ("residual", "x-seed1", 3)
    assert (other["family"], other["success"]) == ("paper", "0.60 (0.60), paper 0.99")
    assert len(MAIN) == 9


def test_training_time_is_in_cpu_minutes() -> None:
    card = final(shipped_cards())[0]
    row, unknown = policy_rows(
        [
            card.model_copy(update={"training": {"frames": 7_200_000, **more}})
            for more in ({"cpu_seconds": 754.2}, {})
        ]
    )
    assert (row["frames (M)"], row["CPU minutes"], unknown["CPU minutes"]) == ("7.2", "13", "-")


@pytest.mark.slow
def test_the_picture_is_drawn(tmp_path: Path) -> None:
    draw(tmp_path / "learning.png")
    assert (tmp_path / "learning.png").read_bytes().startswith(b"\x89PNG")


def test_all_shipped_policies_together_are_small() -> None:
    assert sum(path.stat().st_size for path in HERE.rglob("*") if path.is_file()) < 30 * 2**20


@pytest.mark.slow
def test_independent_agents_ignore_messages() -> None:
    model = independent_ppo.train("blind_discovery_v0", n_agents=2, frames=1, seed=0)
    policy = independent_ppo.IndependentPolicy(model)
    x = torch.randn(4, 2, 5)
    loc = policy.distribution(x).loc
    for mask in (torch.eye(2), torch.eye(2).expand(4, 2, 2)):
        assert torch.equal(policy.distribution(x, mask).loc, loc)
    sb3, _ = model.predict(x.reshape(-1, 5).numpy(), deterministic=True)
    torch.testing.assert_close(policy.distribution(x).action.reshape(-1, 2), torch.from_numpy(sb3))


def test_what_is_shipped_is_what_is_planned_setting_for_setting() -> None:
    shipped = {card.name: Run.from_settings(card.training) for card in final(shipped_cards())}
    planned = reference_runs()
    assert shipped.keys() == planned.keys()
    assert [name for name, run in shipped.items() if run != planned[name]] == []


def test_checkpoints_are_the_validations_nearest_to_their_percentage() -> None:
    for folder in HERE.glob("*-at*"):
        checkpoint, finished = load_card(folder), load_card(HERE / folder.name.rsplit("-at", 1)[0])
        if checkpoint.family is None:
            continue  # of another trainer
        training = checkpoint.training
        assert training["percent"] in ship.ALONG_TRAINING
        assert training["validation"] in finished.training["curve"]
        # The nearest of ten validations.
        assert abs(training["validation"]["frames"] / training["frames"] - training["percent"] / 100) < 0.05
        assert (checkpoint.initial_seed, checkpoint.family) == (finished.initial_seed, finished.family)
