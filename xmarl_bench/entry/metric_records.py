"""Metrics in an entry: rows of episodes and their means. The table of metrics gives fields and ranges."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import Field, create_model

from xmarl_bench.entry.record import Record, left_out
from xmarl_bench.metrics.table import Group, Metric, metrics_of
from xmarl_bench.records.field_types import ROUNDING, Count

R = TypeVar("R", bound=Record)


class Summary(Record):
    value: float | None
    interval: tuple[float, float] | None
    n: Count
    n_nan: Count


class MetricsRow(Record):
    """A number per metric."""

    if TYPE_CHECKING:  # the table of metrics gives the fields

        def __getattr__(self, name: str) -> float | None: ...


class MetricsMeans(Record):
    """A summary per metric."""

    if TYPE_CHECKING:  # None for some metrics, see `Metric.nullable`

        def __getattr__(self, name: str) -> Summary | Any: ...


def _row_type(metric: Metric) -> Any:
    low, high = metric.range.low, metric.range.high
    least = metric.range.least if low is None else low - ROUNDING
    number = Annotated[float, Field(ge=least, le=None if high is None else high + ROUNDING)]
    return number | None


def _mean_type(metric: Metric) -> Any:
    return Summary | None if metric.nullable else Summary


def of_metrics(type_of: Callable[[Metric], Any], *groups: Group) -> Callable[[type[R]], type[R]]:
    """Class decorator: adds to a model a field for each metric of these groups."""

    def extend(model: type[R]) -> type[R]:
        fields: dict[str, Any] = {
            metric.name: (type_of(metric), left_out() if metric.optional else ...)
            for metric in metrics_of(*groups)
        }
        return create_model(
            model.__name__, __base__=model, __doc__=model.__doc__, __module__=model.__module__, **fields
        )

    return extend


@of_metrics(_row_type, Group.EXPLANATION)
class ExplanationRow(MetricsRow):
    """Scores of a mask on one episode. A metric is null if it is not a number."""


@of_metrics(_row_type, Group.BEHAVIOUR, Group.BEHAVIOUR_UNDER)
class BehaviourRow(MetricsRow):
    """Task metrics of the team on the explanation and on its complement; null in episodes not played."""


@of_metrics(_row_type, Group.SANITY)
class SanityRow(MetricsRow):
    """Sanity checks of the explainer; null if not checked."""


@of_metrics(_row_type, Group.POLICY)
class PolicyRow(MetricsRow):
    """Metrics that depend on the policy only."""


class BudgetRow(Record):
    """FidDelta@k over one episode, k = 1 .. M - 1 of M senders: the input of `budgeted_fidelity`."""

    explained: tuple[float | None, ...]  # of the k highest edges of the mask's rows
    random: tuple[float | None, ...] | None  # of a random ranking, in expectation; null without an oracle
    oracle: tuple[float | None, ...] | None  # of the best k edges
    random_error: tuple[float | None, ...] | None = left_out()  # standard error of `random`, if sampled


@of_metrics(_row_type, Group.SANITY, Group.POLICY, Group.GAIN, Group.TASK)
class EpisodeRow(ExplanationRow, BehaviourRow):
    """One episode. A metric is null if it is not a number or was not measured."""

    seed: Annotated[int, Field(ge=0, lt=2**53)]
    length: Annotated[int, Field(ge=1, le=10**6)]  # steps of the episode
    timesteps: Annotated[int, Field(ge=1, le=10**6)]  # number of explained steps
    budget: BudgetRow | None = None
    comm_budget: BudgetRow | None = None  # own edges always kept: M = N - 1
    mean_budget: BudgetRow | None = None  # the same under the other absence models
    resample_budget: BudgetRow | None = None
    renormalised_budget: BudgetRow | None = None


@of_metrics(_mean_type, Group.EXPLANATION)
class ExplanationMetrics(MetricsMeans):
    """The means of `ExplanationRow`; null if a metric was not measured."""


@of_metrics(_mean_type, Group.BEHAVIOUR, Group.BEHAVIOUR_UNDER)
class BehaviourMetrics(MetricsMeans):
    """The means of `BehaviourRow` over the episodes played; null if none was."""


class ControlMetrics(ExplanationMetrics, BehaviourMetrics):
    """A control on the same episodes."""


@of_metrics(_mean_type, Group.SANITY, Group.POLICY, Group.GAIN, Group.TASK)
class Metrics(ExplanationMetrics, BehaviourMetrics):
    """Every metric of a cell; null if it was not measured, see `CellResult.not_measured`."""
