"""Files of entries: written whole, in canonical JSON by lines, and read with every check there is."""

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
    """What the file of an entry holds."""
    return json_lines(entry.model_dump(mode="json"), 4) + b"\n"


def write_entry(folder: Path, entry: Entry) -> Path:
    path = folder / entry.file_name
    write_atomically(path, entry_text(entry))
    return path


def read_entry(path: Path) -> Entry:
    """Read and validate one entry. Raises InputError, also where its numbers are not those of its id."""
    try:
        return parse_entry(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}).") from None
    except ValueError as error:
        raise InputError(f"{path} {error}.") from None


def parse_entry(data: bytes) -> Entry:
    """The entry of JSON text. Raises ValueError, whose text is a clause without a full stop: "is no ..."."""
    entry = _as_written(data)
    return _parse(data) if entry is None else entry


def _as_written(data: bytes) -> Entry | None:
    """The entry of the text that `entry_text` makes of it, wherever its lines break; None of any other.

    What `_parse` checks in half the time, for canonical JSON holds no key twice, no NaN and no 1 for 1.0.
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
    """The entry of any JSON text, or what is wrong with it."""
    try:
        value = parse_json(data)
    except ValueError as error:
        raise ValueError(f"is not an entry: it {error}") from None
    version = value.get("schema_version") if isinstance(value, dict) else SCHEMA_VERSION
    if version != SCHEMA_VERSION:
        raise ValueError(
            f"has schema_version {shown(version)}, this version of xmarl-bench reads {SCHEMA_VERSION}: "
            f"score it again, or move it away"
        )
    try:
        entry = Entry.model_validate_json(data)
    except ValidationError as error:
        said, where = first_error(error)
        where = shown(where, 120).strip("'") or "the whole file"
        raise ValueError(f"is not an entry: {said} at {where}") from None
    if entry_id(entry) != entry.entry_id:
        raise ValueError("was changed after it was written (its entry_id does not fit): score it again")
    if canonical_json(value) != canonical_json(entry.model_dump(mode="json")):
        raise ValueError("is not written as entries are (a key left out, 1 for 1.0): score it again")
    return entry


def read_entries(folder: Path) -> Sequence[tuple[Path, Entry]]:
    """Every entry of a folder, by file name."""
    return [(path, read_entry(path)) for path in sorted(folder.glob("*.json"))]
