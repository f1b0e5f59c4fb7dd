"""The entry: one (policy, explainer) pair scored over a list of cells, one strict JSON file.

Unknown keys, NaN and infinity are refused. `entry_id` is the sha256 of the canonical JSON without
`verification`, which others add later, and without `provenance` and `cost`, which say where and how fast
the entry was made: the same score made twice has the same id.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from xmarl_bench.errors import InputError
from xmarl_bench.files import canonical_json, write_json
from xmarl_bench.policy import Architecture
from xmarl_bench.protocol import PROTOCOL

SCHEMA_VERSION: Final = 2


class Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class PolicyRecord(Record):
    name: str
    task: str
    n_agents: int  # the team size it was trained for
    weights_sha256: str
    architecture: Architecture
    attention_entropy: float
    training_seed: int | None
    code: str | None = None  # where its training code is


class ExplainerRecord(Record):
    name: str
    distribution: str | None  # None: an object passed in Python, not an installed plugin
    version: str | None
    entry_point: str
    hyperparameters: dict[str, bool | int | float | str | None]
    stochastic: bool
    control: bool
    seed: int


class Protocol(Record):
    """What was measured and on which states. Entries share a table only where this is identical."""

    id: Literal["xmarl-2"] = PROTOCOL
    episodes: int
    seeds: tuple[int, ...]
    timesteps: int | None  # at most so many of each episode; None is all
    definitions: dict[str, str]


class Summary(Record):
    value: float | None
    interval: tuple[float, float] | None
    n: int
    n_nan: int


class ExplanationRow(Record):
    """What a mask scores on one episode. A metric is null where it is not a number."""

    fid_plus: float | None
    fid_minus: float | None
    fid_delta: float | None
    gef: float | None
    median_kl: float | None
    mask_mass: float | None
    topk_fid_delta: float | None
    budgeted_fidelity: float | None
    comm_fid_plus: float | None
    comm_fid_minus: float | None
    comm_fid_delta: float | None
    comm_gef: float | None
    comm_topk_fid_delta: float | None
    comm_budgeted_fidelity: float | None
    renorm_topk_fid_delta: float | None
    renorm_budgeted_fidelity: float | None


class BehaviourRow(Record):
    """How the team did on the explanation and on the rest; null in episodes that were not played so."""

    success_on_explanation: float | None
    success_on_complement: float | None
    reward_on_explanation: float | None
    reward_on_complement: float | None
    behavioural_fidelity: float | None


class EpisodeRow(ExplanationRow, BehaviourRow):
    """One episode. A metric is null where it is not a number, or where it was not measured."""

    seed: int
    length: int  # steps of the episode
    timesteps: int  # of which so many were explained
    seed_stability: float | None
    weight_randomisation: float | None
    communication_dependence: float | None
    attention_entropy: float | None
    attention_distance: float | None
    reward: float | None
    success_rate: float | None
    no_agent_collision: float | None
    no_object_collision: float | None
    makespan: float | None


class ExplanationMetrics(Record):
    """The means of `ExplanationRow`; null where a metric was not measured."""

    fid_plus: Summary
    fid_minus: Summary
    fid_delta: Summary
    gef: Summary
    median_kl: Summary
    mask_mass: Summary
    topk_fid_delta: Summary | None
    budgeted_fidelity: Summary | None
    comm_fid_plus: Summary
    comm_fid_minus: Summary
    comm_fid_delta: Summary
    comm_gef: Summary
    comm_topk_fid_delta: Summary | None
    comm_budgeted_fidelity: Summary | None
    renorm_topk_fid_delta: Summary | None
    renorm_budgeted_fidelity: Summary | None


class BehaviourMetrics(Record):
    """The means of `BehaviourRow`, over the episodes that were played so; null where none was."""

    success_on_explanation: Summary | None
    success_on_complement: Summary | None
    reward_on_explanation: Summary | None
    reward_on_complement: Summary | None
    behavioural_fidelity: Summary | None


class ControlMetrics(ExplanationMetrics, BehaviourMetrics):
    """A control on the same episodes."""


class Metrics(ExplanationMetrics, BehaviourMetrics):
    """Every metric of a cell; null where it was not measured, see `CellResult.not_measured`."""

    seed_stability: Summary | None
    weight_randomisation: Summary | None
    communication_dependence: Summary
    attention_entropy: Summary | None
    attention_distance: Summary | None
    reward: Summary
    success_rate: Summary
    no_agent_collision: Summary
    no_object_collision: Summary | None
    makespan: Summary


class CellResult(Record):
    task: str
    n_agents: int
    max_cycles: int
    metrics: Metrics
    not_measured: dict[str, str]  # metric -> why it is null
    controls: dict[str, ControlMetrics]
    behaviour_episodes: int  # the first so many were also played on the explanation and on the complement
    episodes: tuple[EpisodeRow, ...]


class Cost(Record):
    """Wall clock on one thread. No part of the entry's id."""

    explain_seconds_per_timestep: float  # masks only, no metrics
    explained_timesteps: int
    shared_seconds_per_timestep: float  # oracle, controls and their metrics: once for all explainers
    behaviour_seconds: float  # the rollouts on the explanation and on the complement


class Provenance(Record):
    harness_version: str
    commit: str | None
    dirty: bool | None
    packages: dict[str, str]
    python: str
    os: str
    cpu: str
    threads: int  # per worker
    jobs: int
    command: str
    started: str  # ISO 8601, UTC
    finished: str


class Verification(Record):
    status: Literal["unverified", "schema-valid", "recomputed", "spot-rerun", "re-executed"] = "unverified"
    by: str | None = None
    when: str | None = None
    max_abs_diff: float | None = None


class Entry(Record):
    schema_version: Literal[2] = SCHEMA_VERSION
    entry_id: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    submitter: str | None
    policy: PolicyRecord
    explainer: ExplainerRecord
    protocol: Protocol
    results: tuple[CellResult, ...]
    cost: Cost
    provenance: Provenance
    reported: dict[str, JsonValue] | None = (
        None  # claims of a paper or submitter, kept apart from measurements
    )
    verification: Verification = Verification()

    @property
    def file_name(self) -> str:
        """The same policy, explainer, protocol and cells: the same file, so a new score replaces the old."""
        cells = [[cell.task, cell.n_agents, cell.max_cycles] for cell in self.results]
        scope = canonical_json([self.protocol.model_dump(mode="json"), self.explainer.seed, cells])
        return f"{self.policy.name}.{self.explainer.name}.{hashlib.sha256(scope).hexdigest()[:8]}.json"


def make_entry(**fields: Any) -> Entry:
    """An entry with its id computed."""
    draft = Entry(entry_id="0" * 64, **fields)
    return draft.model_copy(update={"entry_id": entry_id(draft)})


def entry_id(entry: Entry) -> str:
    content = entry.model_dump(mode="json", exclude={"entry_id", "verification", "provenance", "cost"})
    return hashlib.sha256(canonical_json(content)).hexdigest()


def write_entry(folder: Path, entry: Entry) -> Path:
    path = folder / entry.file_name
    write_json(path, entry.model_dump(mode="json"))
    return path


def read_entry(path: Path) -> Entry:
    """Read and validate one entry. Raises InputError, also where its numbers are not those of its id."""
    try:
        entry = Entry.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}).") from None
    except ValidationError as error:
        first = next((e for e in error.errors() if e["loc"] == ("schema_version",)), error.errors()[0])
        where = ".".join(str(part) for part in first["loc"]) or "the whole file"
        if where == "schema_version":
            raise InputError(
                f"{path} has schema_version {first['input']!r}, this version of xmarl-bench reads "
                f"{SCHEMA_VERSION}: score it again, or move it away."
            ) from None
        raise InputError(f"{path} is not an entry: {first['msg']} at {where}.") from None
    if entry_id(entry) != entry.entry_id:
        raise InputError(
            f"{path} was changed after it was written (its entry_id does not fit): score it again."
        )
    return entry


def read_entries(folder: Path) -> Sequence[tuple[Path, Entry]]:
    """Every entry of a folder, by file name."""
    return [(path, read_entry(path)) for path in sorted(folder.glob("*.json"))]
