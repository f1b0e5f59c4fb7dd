"""The default policy of each cell: the best of the training seeds, by what the cards say they can do."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from xmarl_bench.policy import PolicyCard


def worth(card: PolicyCard) -> tuple[float, float]:
    """What the best is chosen by: success to two digits, then the rates of episodes without collisions."""
    heard = card.performance["with_messages"]
    free = [heard[name] for name in ("no_agent_collision", "no_object_collision") if heard[name] is not None]
    return round(heard["success_rate"], 2), sum(free)


def is_checkpoint(card: PolicyCard) -> bool:
    """Whether it is a moment along a training, and not the end of one."""
    return "percent" in card.training


def is_final(card: PolicyCard) -> bool:
    """Whether it is the end of a training, and was measured."""
    return not is_checkpoint(card) and "with_messages" in card.performance


def default_policies(cards: Iterable[PolicyCard]) -> list[PolicyCard]:
    """One card per task, team size and with or without the attention-entropy term; the first of equals."""
    cells: defaultdict[tuple[str, int, bool], list[PolicyCard]] = defaultdict(list)
    for card in cards:
        if is_final(card):
            cells[card.task, card.n_agents, card.attention_entropy > 0].append(card)
    return [max(group, key=worth) for _, group in sorted(cells.items())]
