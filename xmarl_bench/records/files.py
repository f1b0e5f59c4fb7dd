"""Files are written whole or not at all, and JSON always in one canonical form."""

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

    sync: survive a power failure too; needless for what a reader checks. Raises InputError where the disk is
    full or the folder cannot be written to.
    """
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # The name says which process on which machine is at it: what a killed one left can be told.
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
                f"{path} cannot be written ({error.strerror}): free the disk or give another folder; what is "
                f"there already is whole."
            ) from error
        raise


def remove_leftovers(folder: Path) -> None:
    """Temporary files of processes of this machine that are no more; those of others are let be."""
    ours = re.compile(rf"\..*\.{re.escape(socket.gethostname())}-([0-9]+)-[^-]*\.tmp")
    for path in folder.glob(".*.tmp"):
        match = ours.fullmatch(path.name)
        if match is not None and not is_running(int(match[1])):
            path.unlink(missing_ok=True)


def is_running(pid: int) -> bool:
    """Whether this machine has such a process."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is somebody else's
        return True
    return True


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps other runs out of a folder, made if missing and taken away if nothing came of it.

    The lock is the operating system's: it ends with the process that holds it, however that ends. Raises
    InputError where another run holds it.
    """
    from filelock import FileLock, Timeout  # here: reading files needs no lock

    check_writable(folder)
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    try:
        with FileLock(path, blocking=False):
            try:
                yield
            finally:
                path.unlink(missing_ok=True)  # while it is held: whoever waits for it looks again
                if made and not any(folder.iterdir()):
                    folder.rmdir()
    except Timeout:
        raise InputError(
            f"another run is writing to {folder}: wait until it is done, or give another folder."
        ) from None


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
