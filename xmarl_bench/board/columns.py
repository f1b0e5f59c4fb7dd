"""What the board shows, in which order, and what it takes to be ranked."""

from __future__ import annotations

from xmarl_bench.metrics import table
from xmarl_bench.metrics.table import METRICS, OF_EXPLAINERS, OF_POLICIES, columns_of

ORDER = {
    "by": table.ORDER,
    "direction": "descending",
    "controls": "shown in place, not ranked",
    "note": "Communication-only budgeted fidelity: 0 is a random ranking of the messages, 1 the best one. "
    "FidDelta alone can be gamed: the mask of ones, a control, attains most of it.",
}
# A team that fails has nothing worth explaining, and one that hardly listens makes every explanation of its
# messages trivially faithful. The dependence is 1 % of the range of an action, [-1, 1].
GATE = {table.SUCCESS: 0.5, table.DEPENDENCE: 0.02}
# Metric -> heading; an arrow says which way is better.
COLUMNS = {metric.name: metric.column_heading for metric in columns_of(*OF_EXPLAINERS)}
PAPER = tuple(metric.name for metric in METRICS if metric.in_paper)  # beside the order in every table
POLICY_METRICS = tuple(metric.name for metric in columns_of(*OF_POLICIES))
