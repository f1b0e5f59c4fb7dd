"""The default policy of each cell: the best of the training seeds, by how well they did their task in
validation. No explanation has a part in it, and no episode that scoring plays."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping

from xmarl_envs import TASKS

from xmarl_bench.policy.bundle import PolicyCard

DEFAULT_FAMILY = "residual"


def selection_key(task: str, seen: Mapping[str, float | None]) -> tuple[float, float]:
    """What policies and moments of a training are chosen by, from task metrics; larger is better.

    Success, plus the rates of episodes without collisions where the task punishes them; then the shorter
    makespan.
    """
    counted = ["success_rate"]
    if hasattr(TASKS[task], "collision_penalty"):
        counted += ["no_agent_collision", "no_object_collision"]
    return sum(seen.get(name) or 0.0 for name in counted), -(seen["makespan"] or 0.0)


def is_checkpoint(card: PolicyCard) -> bool:
    """Whether it is a moment along a training, and not the end of one."""
    return "percent" in card.training


def default_policies(cards: Iterable[PolicyCard], family: str = DEFAULT_FAMILY) -> list[PolicyCard]:
    """One card per task, team size and with or without the attention-entropy term; the first of equals.

    It is of the family where the cell has one of it. Checkpoints, and policies without a validation, stand
    for nothing.
    """
    cells: defaultdict[tuple[str, int, bool], list[PolicyCard]] = defaultdict(list)
    for card in cards:
        if not is_checkpoint(card) and "validation" in card.training:
            cells[card.task, card.n_agents, card.attention_entropy > 0].append(card)
    return [
        max([card for card in group if card.family == family] or group, key=_key)
        for _, group in sorted(cells.items())
    ]


def _key(card: PolicyCard) -> tuple[float, float]:
    return selection_key(card.task, card.training["validation"])
