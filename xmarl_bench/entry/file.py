"""Files of entries: written atomically, in canonical JSON by lines, and checked completely on reading."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from xmarl_bench.entry.schema import SCHEMA_VERSION, Entry, entry_id, id_of
from xmarl_bench.errors import InputError
from xmarl_bench.records.files import canonical_json, write_atomically
from xmarl_bench.records.json_lines import json_lines, members, object_of
from xmarl_bench.records.strict_json import check_size, first_error, has_long_integer, parse_json, shown


def entry_text(entry: Entry) -> bytes:
    """The content of an entry's file."""
    return json_lines(entry.model_dump(mode="json"), 4) + b"\n"


def write_entry(folder: Path, entry: Entry) -> Path:
    path = folder / entry.file_name
    write_atomically(path, entry_text(entry))
    return path


def read_entry(path: Path) -> Entry:
    """Read and validate one entry. Raises InputError if it is invalid or its id does not fit its content."""
    try:
        return parse_entry(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give the file of an entry.") from None
    except ValueError as error:
        raise InputError(f"{path} {error}.") from None


def parse_entry(data: bytes) -> Entry:
    """The entry of JSON text. Raises ValueError, with a clause without a full stop: "is not an entry ..."."""
    entry = _as_written(data)
    return _parse(data) if entry is None else entry


def _as_written(data: bytes) -> Entry | None:
    """The entry, if the text is what `entry_text` makes of it, apart from line breaks; else None.

    Checks the same as `_parse` in half the time, because canonical JSON has no repeated keys, NaN or 1 for
    1.0.
    """
    try:
        check_size(data)
        entry = Entry.model_validate_json(data)
        parts = members(entry.model_dump(mode="json"))
    except ValueError:
        return None
    text = object_of(parts)
    same = text == data.translate(None, b"\n") and not has_long_integer(text)
    return entry if same and id_of(parts) == entry.entry_id else None


def _parse(data: bytes) -> Entry:
    """The entry of any JSON text. Raises ValueError that says what is wrong with it."""
    try:
        value = parse_json(data)
    except ValueError as error:
        raise ValueError(f"is not an entry: it {error}") from None
    version = value.get("schema_version") if isinstance(value, dict) else SCHEMA_VERSION
    if version != SCHEMA_VERSION:
        raise ValueError(
            f"has schema_version {shown(version)}, but this version of xmarl-bench reads {SCHEMA_VERSION}: "
            f"score it again, or move it away"
        )
    try:
        entry = Entry.model_validate_json(data)
    except ValidationError as error:
        problem, where = first_error(error)
        where = shown(where, 120).strip("'") or "the whole file"
        raise ValueError(f"is not an entry: {problem} at {where}") from None
    if entry_id(entry) != entry.entry_id:
        raise ValueError("was changed after it was written (its entry_id does not fit): score it again")
    if canonical_json(value) != canonical_json(entry.model_dump(mode="json")):
        raise ValueError("is not in the canonical form (a missing key, 1 for 1.0): score it again")
    return entry


def folder_of_entries(folder: Path) -> Path:
    """The folder itself, or the `entries` in it if it is one that `score` wrote."""
    inner = folder / "entries"
    return inner if inner.is_dir() else folder


def read_entries(folder: Path) -> Sequence[tuple[Path, Entry]]:
    """Every entry of a folder, sorted by file name."""
    return [(path, read_entry(path)) for path in sorted(folder.glob("*.json"))]
