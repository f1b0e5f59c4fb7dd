"""Task performance as Kailas, Jain and Ravichandar (ICML 2025) report it: paper.csv.

Mean and standard deviation, of the tables AllTasksPerformance (main), TrainingIterationPerformance and
ZeroShotPerformance (appendix). Every cell is a pair, without and with attention-entropy minimisation. The
paper reports no collisions for discovery; navigation has no walls.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

NAVIGATION, PASSAGE = "blind_navigation_v0", "blind_passage_v0"


class Reported(NamedTuple):
    """A measure over 50 episodes."""

    mean: float
    std: float


Performance = dict[str, tuple[Reported, Reported]]  # by measure: without, with the attention-entropy term


def _tables() -> tuple[
    dict[tuple[str, int], Performance], dict[int, Performance], dict[tuple[int, int], Performance]
]:
    main: dict[tuple[str, int], Performance] = {}
    training: dict[int, Performance] = {}
    zero_shot: dict[tuple[int, int], Performance] = {}
    with Path(__file__).with_name("paper.csv").open(encoding="utf-8", newline="") as file:
        _, *rows = csv.reader(file)
    for task, trained, tested, percent, measure, *numbers in rows:
        if percent:
            cell = training.setdefault(int(percent), {})
        elif trained == tested:
            cell = main.setdefault((task, int(trained)), {})
        else:
            cell = zero_shot.setdefault((int(trained), int(tested)), {})
        mean, std, mean_with, std_with = map(float, numbers)
        cell[measure] = Reported(mean, std), Reported(mean_with, std_with)
    return main, training, zero_shot


# By task and team size; of navigation with three agents, by percent of training; of navigation, by agents in
# training and in the test.
MAIN, TRAINING, ZERO_SHOT = _tables()
