"""The entry: one (policy, explainer) pair scored over a list of cells, one strict JSON file.

Unknown keys, NaN and infinity are refused. `entry_id` is the sha256 of the canonical JSON without
`verification`, which others add later, and without `provenance` and `cost`, which say where and how fast
the entry was made: the same score made twice has the same id.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from xmarl_bench.errors import InputError
from xmarl_bench.files import canonical_json, write_json
from xmarl_bench.policy import Architecture

PROTOCOL = "xmarl-1"
DEFINITIONS: dict[str, str] = {
    "F(m)": "action tanh(loc) in [-1, 1] with the message on edge j -> i scaled by m[i, j] after the "
    "softmax, nothing renormalised",
    "fid_minus": "mean over agents of d_i(m), d_i(m) = mean over action entries of |F_i(1) - F_i(m)|",
    "fid_plus": "mean over agents of d_i(1 - m)",
    "fid_delta": "fid_plus - fid_minus",
    "gef": "mean over agents of 1 - exp(-KL(F_i(1) || F_i(m))), diagonal Normals under the tanh, summed over "
    "action entries",
    "median_kl": "median of that KL over the agents and timesteps of an episode",
    "mask_mass": "mean of the mask over all edges, the agents' own among them",
    "communication_dependence": "mean over agents of d_i(identity): what removing all messages between "
    "agents changes",
    "reward": "mean over agents of the return",
    "success_rate": "fraction of agents at goal when the episode ends; discovery: 1 if found",
    "no_agent_collision": "1 if no two agents collided in the episode",
    "no_object_collision": "1 if nobody touched a wall; null where there are no walls",
    "makespan": "steps until done, max_cycles if never",
    "aggregation": "mean over timesteps within an episode, then mean over episodes; percentile bootstrap "
    "interval (95 %) over episodes; what is not a number is left out and counted in n_nan",
    "timesteps": "null: all T of an episode; K: at most K, number floor((2 k + 1) T / (2 K)), k = 0 .. K - 1",
    "seeds": "environment seed of each episode: 10^12 + seed * 10^6 + k",
}


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

    id: Literal["xmarl-1"] = "xmarl-1"
    episodes: int
    seeds: tuple[int, ...]
    timesteps: int | None  # at most so many of each episode; None is all
    definitions: dict[str, str]


class Summary(Record):
    value: float | None
    interval: tuple[float, float] | None
    n: int
    n_nan: int


class EpisodeRow(Record):
    """One episode. A metric is null where it is not a number, or where the task has no such thing."""

    seed: int
    length: int  # steps of the episode
    timesteps: int  # of which so many were explained
    fid_plus: float | None
    fid_minus: float | None
    fid_delta: float | None
    gef: float | None
    median_kl: float | None
    mask_mass: float | None
    communication_dependence: float | None
    reward: float | None
    success_rate: float | None
    no_agent_collision: float | None
    no_object_collision: float | None
    makespan: float | None


METRICS: tuple[str, ...] = tuple(
    name for name in EpisodeRow.model_fields if name not in ("seed", "length", "timesteps")
)


class Metrics(Record):
    """Every metric of a cell; null where the task has no such thing."""

    fid_plus: Summary
    fid_minus: Summary
    fid_delta: Summary
    gef: Summary
    median_kl: Summary
    mask_mass: Summary
    communication_dependence: Summary
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
    episodes: tuple[EpisodeRow, ...]


class Cost(Record):
    explain_seconds_per_timestep: float  # wall clock on one thread; masks only, no metrics
    explained_timesteps: int


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
    schema_version: Literal[1] = 1
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
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the whole file"
        raise InputError(f"{path} is not an entry: {first['msg']} at {where}.") from None
    if entry_id(entry) != entry.entry_id:
        raise InputError(
            f"{path} was changed after it was written (its entry_id does not fit): score it again."
        )
    return entry


def read_entries(folder: Path) -> Sequence[tuple[Path, Entry]]:
    """Every entry of a folder, by file name."""
    return [(path, read_entry(path)) for path in sorted(folder.glob("*.json"))]
