"""The manifest of a submission bundle: its submitter and the hash of every file."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Mapping
from typing import Annotated, Final, Literal

from pydantic import Field

from xmarl_bench.entry.metric_records import EpisodeRow
from xmarl_bench.entry.record import Record
from xmarl_bench.entry.schema import Entry
from xmarl_bench.metrics.table import OPTIONAL
from xmarl_bench.records.csv_cells import csv_cell
from xmarl_bench.records.field_types import Count, Person, Sha256, Text

BUNDLE_VERSION: Final = 1
ROW_COLUMNS = tuple(name for name in EpisodeRow.model_fields if not name.endswith("budget"))


class FileRecord(Record):
    sha256: Sha256
    bytes: Count


class Manifest(Record):
    """Lists every file of the bundle but the manifest. `leaderboard/manifest.schema.json` is this class."""

    bundle_version: Literal[1] = BUNDLE_VERSION
    submitter: Annotated[Person, Field(min_length=1, max_length=200)]
    contact: Text | None = None  # address for questions
    harness_version: Text
    files: Annotated[dict[str, FileRecord], Field(max_length=1000)]


def file_records(files: Mapping[str, bytes]) -> dict[str, FileRecord]:
    return {
        name: FileRecord(sha256=hashlib.sha256(data).hexdigest(), bytes=len(data))
        for name, data in sorted(files.items())
    }


def rows_csv(entry: Entry) -> bytes:
    """An entry's episodes for spreadsheets: one line each; null is an empty cell.

    Numbers read back bit for bit. Columns that an older entry lacks are omitted.
    """
    episodes = [(cell, row) for cell in entry.results for row in cell.episodes]
    columns = [
        name
        for name in ROW_COLUMNS
        if name not in OPTIONAL or any(getattr(row, name) is not None for _, row in episodes)
    ]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["task", "n_agents", *columns])
    for cell, row in episodes:
        values = [getattr(row, name) for name in columns]
        writer.writerow(
            [csv_cell(cell.task), cell.n_agents, *("" if each is None else each for each in values)]
        )
    return text.getvalue().encode()
