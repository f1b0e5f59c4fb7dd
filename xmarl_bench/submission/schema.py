"""The published JSON Schemas, written by `python -m xmarl_bench.submission.schema leaderboard`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from xmarl_bench.entry.record import Record
from xmarl_bench.entry.schema import Entry
from xmarl_bench.records.files import pretty_json, write_atomically
from xmarl_bench.submission.manifest import Manifest

DIALECT = "https://json-schema.org/draft/2020-12/schema"
PUBLISHED: dict[str, type[Record]] = {"entry.schema.json": Entry, "manifest.schema.json": Manifest}


def schema(model: type[Record]) -> dict[str, Any]:
    """JSON Schema of a record, without unknown keys. It does not check that numbers are consistent."""
    return {"$schema": DIALECT, **model.model_json_schema()}


def publish(folder: Path) -> None:
    for name, model in PUBLISHED.items():
        write_atomically(folder / name, pretty_json(schema(model)))


if __name__ == "__main__":
    publish(Path(sys.argv[1]))
