"""The default policy of each cell: the training seed with the best task metrics in validation.

The choice uses no explanation and no episode that scoring plays.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping

from xmarl_envs import TASKS

from xmarl_bench.policy.card import PolicyCard

DEFAULT_FAMILY = "residual"


def selection_key(task: str, seen: Mapping[str, float | None]) -> tuple[float, float]:
    """Key by which policies and checkpoints are selected, from validation metrics; larger is better.

    Success, plus the rates of episodes without collisions if the task penalises them; then the shorter
    makespan.
    """
    counted = ["success_rate"]
    if hasattr(TASKS.get(task), "collision_penalty"):
        counted += ["no_agent_collision", "no_object_collision"]
    return sum(seen.get(name) or 0.0 for name in counted), -(seen["makespan"] or 0.0)


def is_checkpoint(card: PolicyCard) -> bool:
    """Whether the policy was saved during training, not at its end."""
    return "percent" in card.training


def default_policies(cards: Iterable[PolicyCard]) -> list[PolicyCard]:
    """The best card of each task and team size, with and without the attention-entropy term.

    Prefers `DEFAULT_FAMILY` in cells that have it; the first of equals. Skips checkpoints and policies
    without validation metrics.
    """
    cells: defaultdict[tuple[str, int, bool], list[PolicyCard]] = defaultdict(list)
    for card in cards:
        if not is_checkpoint(card) and "validation" in card.training:
            cells[card.task, card.n_agents, card.attention_entropy > 0].append(card)
    return [
        max(
            [card for card in group if card.family == DEFAULT_FAMILY] or group,
            key=lambda card: selection_key(card.task, card.training["validation"]),
        )
        for _, group in sorted(cells.items())
    ]
