"""The entry: one (policy, explainer) pair scored over a list of cells, one strict JSON file.

Unknown or repeated keys, NaN, infinity and values outside a metric's range are errors. `entry_id` is the
sha256 of the canonical JSON without `verification`, which others add later, and without `provenance` and
`cost`, which tell where and how fast the entry was made: scoring again gives the same id. A file is canonical
JSON with line breaks: each episode, control and metric has its own line. `leaderboard/entry.schema.json` is
this file as JSON Schema.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, JsonValue, create_model

from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.metrics.budgeted_fidelity import OracleKind
from xmarl_bench.metrics.table import Group, Metric, metrics_of
from xmarl_bench.policy.architecture import AnyArchitecture
from xmarl_bench.records.columns import ByColumn
from xmarl_bench.records.field_types import (
    ROUNDING,
    Agents,
    Count,
    Link,
    Name,
    NotNegative,
    Person,
    Seconds,
    Sha256,
    Text,
)
from xmarl_bench.records.files import canonical_json
from xmarl_bench.records.json_lines import members, object_of
from xmarl_bench.reproducible import LONGEST_VALUE

SCHEMA_VERSION: Final = 5
NOT_HASHED = ("entry_id", "verification", "provenance", "cost")


class Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def left_out() -> Any:
    """The default of a field that is None in older entries: left out of the text then, so ids stay."""
    return Field(default=None, exclude_if=_is_none)


def _is_none(value: object) -> bool:
    return value is None


R = TypeVar("R", bound=Record)


class PolicyRecord(Record):
    name: Name
    task: Name
    n_agents: Agents  # the team size it was trained for
    weights_sha256: Sha256
    architecture: AnyArchitecture
    attention_entropy: float
    training_seed: int | None
    code: Text | None = None  # link to its training code
    trusted_code: bool = False  # the policy ran its own code
    # False: its code ran in the process that measured, for debugging. None: all others.
    isolated: Literal[False] | None = left_out()


class ExplainerRecord(Record):
    """The explainer and its declarations."""

    name: Name
    distribution: Text | None  # None: an object passed in Python or a file, not an installed plugin
    version: Text | None
    entry_point: Text
    hyperparameters: Annotated[dict[Text, bool | int | float | Text | None], Field(max_length=100)]
    stochastic: bool
    control: bool
    seed: Annotated[int, Field(ge=0, lt=10**9)]
    batched: bool = True  # False: called for one timestep at a time
    binary: bool = False  # masks of zeros and ones
    signed: Text | None = None  # formula that maps signed attributions to masks; None: not signed
    # Declared to return importances of nodes, which fill the sender's column of a mask.
    node_importance: bool | None = left_out()
    needs_fit: bool = False  # fitted on other states before it explains
    # To the policy, or to the episode's simulator as well; None: undeclared.
    accesses: Literal["black-box", "gradients", "attention", "simulator"] | None = None
    code: Text | None = None  # link to its code
    paper: Link | None = left_out()  # link to its paper
    code_sha256: Sha256 | None = None  # of the file that it was loaded from
    # False: third-party code that ran in the process that measured, for debugging. None: all others.
    isolated: Literal[False] | None = left_out()


class TaskRecord(Record):
    """A task that is not of xmarl_envs: where its code came from."""

    distribution: Text | None  # None: not from an installed package
    version: Text | None
    entry_point: Text
    code_sha256: Sha256 | None  # of the file or the source that makes it; None: of an installed package
    environment: Text  # the class of its environment
    environment_distribution: Text | None
    environment_version: Text | None
    # False: its code ran in the process that measured, for debugging. None: all others.
    isolated: Literal[False] | None = left_out()


class Protocol(Record):
    """What was measured, and on which states. Entries share a table only if their protocols are identical."""

    id: Literal["xmarl-3"] = PROTOCOL
    episodes: Annotated[int, Field(ge=1, le=10**6)]
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**53)], ...]
    timesteps: Annotated[int, Field(ge=1)] | None  # at most so many of each episode; None: all
    definitions: Annotated[dict[Text, Text], Field(max_length=100)]
    tasks: Annotated[dict[Name, TaskRecord], Field(max_length=100)] | None = left_out()  # not of xmarl_envs


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


class OracleRecord(Record):
    """How random@k and oracle@k of a cell were computed: from all rows, or from random ones."""

    kind: OracleKind
    orders: Count | None = left_out()  # random ones, of the senders of each row
    # Standard error that drawing gives a message fidelity of 0, at most; null where it is not a number.
    error: NotNegative | None = left_out()
    definition: Text | None = left_out()


class CellResult(Record):
    task: Name
    n_agents: Agents
    max_cycles: Annotated[int, Field(ge=1, le=10**6)]
    metrics: Metrics
    not_measured: Annotated[dict[Name, Text], Field(max_length=100)]  # metric -> reason why it is null
    controls: Annotated[dict[Name, ControlMetrics], Field(max_length=100)]
    behaviour_episodes: Count  # number of first episodes also played on the explanation and its complement
    absence_behaviour_episodes: Count | None = left_out()  # number of these played under other absence models
    oracle: OracleRecord | None = left_out()  # None: enumerated, or `not_measured` gives the reason
    episodes: Annotated[tuple[EpisodeRow, ...], ByColumn(EpisodeRow)]

    @property
    def oracle_kind(self) -> OracleKind:
        """Entries share a table only if this is equal; `enumerated` also if there is no oracle."""
        return "enumerated" if self.oracle is None else self.oracle.kind


class Cost(Record):
    """Wall-clock time on one thread. Not part of the entry's id."""

    explain_seconds_per_timestep: Seconds  # masks only, without metrics
    explained_timesteps: Count
    shared_seconds_per_timestep: Seconds  # oracle, controls and their metrics: once for all explainers
    behaviour_seconds: Seconds  # rollouts on the explanation and on its complement


class Provenance(Record):
    """Numbers repeat bit for bit if `packages`, `python`, `machine` and `cpu_capability` are the same."""

    harness_version: Text
    commit: Text | None
    dirty: bool | None
    packages: Annotated[dict[Text, Text], Field(max_length=100)]
    python: Text
    os: Text
    machine: Text  # x86_64, arm64, ...
    cpu: Text
    cpu_capability: Text  # vector instructions that torch uses; its rounding depends on them
    device: Text | None = left_out()  # of the explainer, if it was not the CPU
    threads: Annotated[int, Field(ge=1)]  # per worker
    jobs: Annotated[int, Field(ge=1)]
    command: Text
    started: Text  # ISO 8601, UTC
    finished: Text


class FreshDifference(Record):
    """A metric on the public episodes and on fresh ones, which are independent samples."""

    public: float | None  # mean
    fresh: float | None
    difference: float | None  # public - fresh
    interval: tuple[float, float] | None  # 95 %


class FreshSeeds(Record):
    """A score on episodes that were unknown when the entry was submitted."""

    value: Annotated[str, Field(min_length=1, max_length=LONGEST_VALUE)]  # from which seeds are derived
    by: Person
    when: Text  # ISO 8601, UTC
    episodes: Annotated[int, Field(ge=1, le=10**6)]  # of each cell
    cells: Annotated[tuple[dict[Name, FreshDifference], ...], Field(min_length=1, max_length=100)]


class Verification(Record):
    """Who verified the numbers, how and with which versions. Written by `xmarl-bench verify` only."""

    status: Literal["unverified", "recomputed", "spot-rerun", "re-executed"] = "unverified"
    by: Person | None = None
    when: Text | None = None  # ISO 8601, UTC
    harness_version: Text | None = None
    commit: Text | None = left_out()  # of the harness that verified
    dirty: bool | None = left_out()  # whether its sources had changes
    packages: Annotated[dict[Text, Text], Field(max_length=100)] | None = None
    machine: Text | None = None
    wall: Text | None = left_out()  # what isolated third-party code; None: it ran none
    episodes: Count = 0  # played and explained again, in all cells
    bitwise: bool | None = None  # compared bit for bit; False: within the tolerance for other machines
    max_abs_diff: NotNegative | None = None  # largest over all numbers compared
    fresh: FreshSeeds | None = left_out()


class Entry(Record):
    schema_version: Literal[5] = SCHEMA_VERSION
    entry_id: Sha256
    submitter: Person | None
    policy: PolicyRecord
    explainer: ExplainerRecord
    protocol: Protocol
    results: Annotated[tuple[CellResult, ...], Field(min_length=1, max_length=100)]
    cost: Cost
    provenance: Provenance
    reported: dict[str, JsonValue] | None = None  # claims of a paper or submitter, separate from measurements
    variants_tried: Annotated[int, Field(ge=1, le=10**9)] | None = left_out()  # on these seeds, as claimed
    verification: Verification = Verification()

    @property
    def file_name(self) -> str:
        """Unique to policy, explainer, protocol and cells, so that a new score replaces the old one."""
        cells = [[cell.task, cell.n_agents, cell.max_cycles] for cell in self.results]
        scope = canonical_json([self.protocol.model_dump(mode="json"), self.explainer.seed, cells])
        return f"{self.policy.name}.{self.explainer.name}.{hashlib.sha256(scope).hexdigest()[:8]}.json"


def make_entry(**fields: Any) -> Entry:
    """An entry with its id computed."""
    draft = Entry(entry_id="0" * 64, **fields)
    return draft.model_copy(update={"entry_id": entry_id(draft)})


def entry_id(entry: Entry) -> str:
    return id_of(members(entry.model_dump(mode="json")))


def id_of(parts: Mapping[str, bytes]) -> str:
    """The id of an entry, from the canonical texts of its fields."""
    hashed = {name: text for name, text in parts.items() if name not in NOT_HASHED}
    return hashlib.sha256(object_of(hashed)).hexdigest()
