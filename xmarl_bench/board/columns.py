"""The board's order and columns."""

from __future__ import annotations

import math

from xmarl_bench.metrics import table
from xmarl_bench.metrics.table import METRICS, OF_EXPLAINERS, OF_POLICIES, UNDER_ABSENCES, by_name, columns_of

ORDER = {
    "by": table.ORDER,
    "direction": "descending",
    "controls": "shown in place, not ranked",
    "note": "Message fidelity: how well an explainer ranks the messages of a receiver. 0 is a random "
    "ranking, 1 the best one. It is the mean over four absence models, which replace a removed message in "
    "different ways. FidDelta alone can be gamed: the mask of ones, a control, attains most of it.",
}
MOST = by_name()[ORDER["by"]].range.high or math.inf  # the largest possible value of the order
# Metric -> heading, with an arrow in the better direction.
COLUMNS = {metric.name: metric.column_heading for metric in columns_of(*OF_EXPLAINERS)}
PAPER = tuple(metric.name for metric in METRICS if metric.in_paper)  # shown in every table
POLICY_METRICS = tuple(metric.name for metric in columns_of(*OF_POLICIES))
GAMED = "fid_delta"  # drawn against the order, to show what it misses
COMPARED = (*PAPER, "budgeted_fidelity", *UNDER_ABSENCES, ORDER["by"])  # do they order explainers alike?
BY_EPISODE = (ORDER["by"], *PAPER)  # whose distributions over episodes are drawn


def title_of(metric: str) -> str:
    return by_name()[metric].title
