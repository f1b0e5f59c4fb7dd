"""Files of entries: written atomically, in canonical JSON by lines, and checked completely on reading.

An entry's text is whole. Its file in a folder names, in place of what entries of its policy share, the sha256
of the file `shared/<sha256>.json` beside it. The entry's id covers both, whichever form they were read in.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

from pydantic import ValidationError

from xmarl_bench.entry.schema import SCHEMA_VERSION, Entry, entry_id, id_of
from xmarl_bench.entry.shared import joined, split
from xmarl_bench.errors import InputError
from xmarl_bench.records.files import canonical_json, write_atomically
from xmarl_bench.records.json_lines import json_lines, members, object_of
from xmarl_bench.records.strict_json import (
    MAX_BYTES,
    check_size,
    first_error,
    has_long_integer,
    parse_json,
    shown,
)

SHARED: Final = "shared"  # the folder of shared parts, and the key that names one
_DIGEST = re.compile(r"[0-9a-f]{64}")
_REFERENCE = re.compile(rb'"shared"\s*:\s*"([0-9a-f]{64})"')


def entry_text(entry: Entry) -> bytes:
    """The whole entry, as in bundles."""
    return _lines(entry.model_dump(mode="json"))


def write_entry(folder: str | Path, entry: Entry) -> Path:
    """Write an entry's file, and its shared part unless another entry has written it."""
    folder = Path(folder)
    own, shared = split(entry.model_dump(mode="json"))
    part = _lines(shared)
    digest = hashlib.sha256(part).hexdigest()
    if not _shared_path(folder, digest).is_file():
        write_atomically(_shared_path(folder, digest), part)
    path = folder / entry.file_name
    write_atomically(path, _lines({**own, SHARED: digest}))
    return path


def remove_unused(folder: Path) -> None:
    """Delete the shared parts that no entry of the folder names. Nobody else may write to it meanwhile."""
    named = {found for path in folder.glob("*.json") for found in _REFERENCE.findall(path.read_bytes())}
    for path in (folder / SHARED).glob("*.json"):
        if path.stem.encode() not in named:
            path.unlink()


def _lines(value: Any) -> bytes:
    return json_lines(value, 4) + b"\n"


def _shared_path(folder: Path, digest: str) -> Path:
    return folder / SHARED / f"{digest}.json"


def read_entry(path: str | Path) -> Entry:
    """Read and validate one entry. Raises InputError if it is invalid or its id does not fit its content."""
    path = Path(path)
    try:
        return parse_entry(path.read_bytes(), path.parent)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give the file of an entry.") from None
    except ValueError as error:
        raise InputError(f"{path} {error}.") from None


def parse_entry(data: bytes, folder: Path | None = None) -> Entry:
    """The entry of JSON text. Raises ValueError, with a clause without a full stop: "is not an entry ...".

    folder: where its shared part is; None: the text must be whole.
    """
    if _REFERENCE.search(data):
        data = _whole(data, folder)
    entry = _as_written(data)
    return _parse(data) if entry is None else entry


def _whole(data: bytes, folder: Path | None) -> bytes:
    """The canonical text of a file joined with the shared part that it names."""
    try:
        own = parse_json(data)
    except ValueError:
        return data  # refused as any other
    digest = own.pop(SHARED, None) if isinstance(own, dict) else None
    if not isinstance(digest, str) or _DIGEST.fullmatch(digest) is None:
        return data
    if folder is None:
        raise ValueError("names a shared part, but a bundle holds whole entries: pack it with `submit`")
    try:
        with _shared_path(folder, digest).open("rb") as file:
            part = file.read(MAX_BYTES + 1)
        if hashlib.sha256(part).hexdigest() != digest:
            raise ValueError(f"has the shared part {digest[:8]}, which was changed after it was written")
        return canonical_json(joined(own, _shared(part)))
    except OSError:
        raise ValueError(f"lacks its shared part {SHARED}/{digest}.json: copy it beside the entry") from None
    except RecursionError:
        raise ValueError("is nested too deep") from None


@lru_cache(maxsize=4)  # entries of a policy come one after another
def _shared(part: bytes) -> Any:
    return parse_json(part)


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


class Listed(NamedTuple):
    entries: list[Path]
    strays: list[Path]  # what a file manager leaves (`.DS_Store`, `._a.json`), and files that are not JSON


def entry_files(folder: Path) -> Listed:
    """The files of a folder of entries, sorted by name. Temporary files are in neither list."""
    listed = Listed([], [])
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        hidden = path.name.startswith(".")
        if not hidden and path.suffix == ".json":
            listed.entries.append(path)
        elif path.name != SHARED and not (hidden and path.suffix in (".tmp", ".lock")):
            listed.strays.append(path)
    return listed


def check_name(path: Path, entry: Entry) -> None:
    """Raise InputError if the file does not have its entry's name: then the entry could be there twice."""
    if path.name != entry.file_name:
        where = path.with_name(entry.file_name)
        what = "remove this copy" if where.exists() else "rename it"
        raise InputError(f"{path} should be named {entry.file_name}, as its entry: {what}.")


def read_entries(folder: Path) -> Sequence[tuple[Path, Entry]]:
    """Every entry of a folder, sorted by file name."""
    return [(path, read_entry(path)) for path in entry_files(folder).entries]
