"""Files are written whole or not at all, and JSON always in one canonical form."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from xmarl_bench.errors import InputError


def write_atomically(path: Path, data: bytes) -> None:
    """Write to a temporary file beside `path`, then rename: a reader sees the old file or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def check_writable(folder: Path) -> None:
    """Raises InputError where `folder` could not be written to, before hours of work find out."""
    nearest = folder
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"cannot write to {folder}: give another folder.")


def canonical_json(value: Any) -> bytes:
    """The one JSON text of a value: sorted keys, no white space, no NaN. Hashes are taken of this."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def pretty_json(value: Any) -> bytes:
    """JSON for people: sorted keys, two spaces. NaN and infinity are refused (ValueError)."""
    return (json.dumps(value, sort_keys=True, indent=2, allow_nan=False) + "\n").encode()


def write_json(path: Path, value: Any) -> None:
    """Write JSON for people, whole or not at all."""
    write_atomically(path, pretty_json(value))
