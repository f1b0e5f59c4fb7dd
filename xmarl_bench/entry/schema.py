"""The entry: one (policy, explainer) pair scored over a list of cells, one strict JSON file.

Unknown or repeated keys, NaN, infinity and values outside a metric's range are errors. `entry_id` is the
sha256 of the canonical JSON without `verification`, which others add later, and without `provenance` and
`cost`, which tell where and how fast the entry was made: scoring again gives the same id. A file is canonical
JSON with line breaks: each episode, control and metric has its own line. `leaderboard/entry.schema.json` is
this file as JSON Schema.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field, JsonValue

from xmarl_bench.entry.metric_records import ControlMetrics, EpisodeRow, Metrics
from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.entry.record import Record, left_out
from xmarl_bench.metrics.budgeted_fidelity import OracleKind
from xmarl_bench.policy.architecture import AnyArchitecture
from xmarl_bench.records.columns import ByColumn
from xmarl_bench.records.field_types import (
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

    @property
    def explain_seconds(self) -> float:
        """For all timesteps."""
        return self.explain_seconds_per_timestep * self.explained_timesteps

    @property
    def shared_seconds(self) -> float:
        """For all timesteps."""
        return self.shared_seconds_per_timestep * self.explained_timesteps


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
