"""Writes files atomically, and JSON in one canonical form."""

from __future__ import annotations

import json
import os
import re
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from xmarl_bench.errors import InputError

LOCK = ".lock"


def write_atomically(path: Path, data: bytes, *, sync: bool = True) -> None:
    """Write to a temporary file beside `path`, then rename: a reader sees the old file or the new one.

    sync: also survive a power failure; unnecessary if readers check the file. Raises InputError if the disk
    is full or the folder cannot be written to.
    """
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # The name holds machine and process, so that leftovers of a killed process can be recognised.
        prefix = f".{path.name}.{socket.gethostname()}-{os.getpid()}-"
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=prefix, suffix=".tmp")
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            if sync:
                file.flush()
                os.fsync(file.fileno())
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(
                f"{path} cannot be written ({error.strerror}): free disk space or give another folder. Files "
                f"written before are intact."
            ) from error
        raise


def remove_leftovers(folder: Path) -> None:
    """Delete temporary files of processes of this machine that have ended. Keeps those of other machines."""
    ours = re.compile(rf"\..*\.{re.escape(socket.gethostname())}-([0-9]+)-[^-]*\.tmp")
    for path in folder.glob(".*.tmp"):
        match = ours.fullmatch(path.name)
        if match is not None and not is_running(int(match[1])):
            path.unlink(missing_ok=True)


def is_running(pid: int) -> bool:
    """Whether a process with this id runs on this machine."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it belongs to another user
        return True
    return True


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder. A missing folder is created, and removed again if it stays empty.

    The operating system releases the lock when the process ends, however it ends. Raises InputError if
    another run holds it.
    """
    from filelock import FileLock, Timeout  # imported lazily: reading files needs no lock

    check_writable(folder)
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    try:
        with FileLock(path, blocking=False):
            try:
                yield
            finally:
                path.unlink(missing_ok=True)  # while the lock is held, so that no other run holds this file
                if made and not any(folder.iterdir()):
                    folder.rmdir()
    except Timeout:
        raise InputError(
            f"another run is writing to {folder}: wait until it is done, or give another folder."
        ) from None


def check_writable(folder: Path) -> None:
    """Raise InputError if `folder` cannot be written to, before hours of work are lost."""
    nearest = folder
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"cannot write to {folder}: give another folder.")


def canonical_json(value: Any) -> bytes:
    """The canonical JSON of a value: sorted keys, no white space, no NaN. Hashes are taken of it."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def pretty_json(value: Any) -> bytes:
    """Readable JSON: sorted keys, two spaces. Raises ValueError for NaN and infinity."""
    return (json.dumps(value, sort_keys=True, indent=2, allow_nan=False) + "\n").encode()


def write_json(path: Path, value: Any) -> None:
    """Write readable JSON atomically."""
    write_atomically(path, pretty_json(value))
