"""Entries and bundles with a fault, everything else made consistent again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from typing import Any

from tests.helpers.by_row import by_column, by_row
from xmarl_bench.entry.aggregation import metrics_of_cell
from xmarl_bench.entry.schema import Entry, entry_id
from xmarl_bench.records.files import canonical_json, pretty_json
from xmarl_bench.submission.archive import MANIFEST
from xmarl_bench.submission.manifest import Manifest, file_records, rows_csv

Edit = Callable[[dict[str, Any]], object]


def with_id(value: dict[str, Any]) -> dict[str, Any]:
    """The JSON with the id of its present content, valid or not."""
    left_out = ("entry_id", "verification", "provenance", "cost")
    content = {key: each for key, each in value.items() if key not in left_out}
    return {**value, "entry_id": hashlib.sha256(canonical_json(content)).hexdigest()}


def edited(entry: Entry, edit: Edit, *, aggregates: bool = False) -> Entry:
    """A valid entry with an edit, which sees episodes by row, and a matching id.

    aggregates: with matching means and intervals too.
    """
    value = entry.model_dump(mode="json")
    for cell in value["results"]:
        cell["episodes"] = by_row(cell["episodes"])
    edit(value)
    value["results"] = [{**cell, "episodes": by_column(cell["episodes"])} for cell in value["results"]]
    changed = Entry.model_validate_json(json.dumps(value))
    if aggregates:
        results = tuple(
            cell.model_copy(update={"metrics": metrics_of_cell(cell, changed.explainer.seed)})
            for cell in changed.results
        )
        changed = changed.model_copy(update={"results": results})
    return changed.model_copy(update={"entry_id": entry_id(changed)})


def with_manifest(files: Mapping[str, bytes], **fields: Any) -> dict[str, bytes]:
    """The files with a manifest of matching checksums."""
    content = {name: data for name, data in files.items() if name != MANIFEST}
    manifest = Manifest.model_validate_json(files[MANIFEST])
    made = manifest.model_copy(update={"files": file_records(content), **fields})
    return {**content, MANIFEST: pretty_json(made.model_dump(mode="json"))}


def with_entry(files: Mapping[str, bytes], entry: Entry) -> dict[str, bytes]:
    """The bundle with the entry of this name replaced, with matching rows and checksums."""
    name = entry.file_name
    changed = {
        **files,
        f"entries/{name}": pretty_json(entry.model_dump(mode="json")),
        f"rows/{name.removesuffix('.json')}.csv": rows_csv(entry),
    }
    return with_manifest(changed)
