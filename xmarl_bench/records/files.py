"""Writes files atomically, and JSON in one canonical form."""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from xmarl_bench.errors import InputError

LOCK = ".lock"
NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def write_atomically(path: Path, data: bytes, *, sync: bool = True) -> None:
    """Write to a temporary file beside `path`, then rename: a reader sees the old file or the new one.

    sync: also survive a power failure; unnecessary if readers check the file. Raises InputError if the disk
    is full or the folder cannot be written to.
    """
    temporary: Path | None = None
    with writing(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary = _temporary_beside(path)
            write_synced(temporary, data, sync=sync)
            temporary.replace(path)
        except BaseException:
            if temporary is not None:
                temporary.unlink(missing_ok=True)
            raise


def write_synced(path: Path, data: bytes, *, sync: bool = True) -> None:
    """Write a file, with the permissions of the umask."""
    with path.open("wb") as file:
        file.write(data)
        if sync:
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """While `path` is written: raises InputError if the disk is full or the folder cannot be written to."""
    try:
        yield
    except OSError as error:
        what = "free disk space or give another folder" if error.errno in NO_SPACE else "give another folder"
        raise InputError(
            f"{path} cannot be written ({error.strerror}): {what}. Files written before are intact."
        ) from error


def _temporary_beside(path: Path) -> Path:
    """A new name that holds machine and process, so that `remove_leftovers` recognises it."""
    # Cut: a file name has at most 255 bytes.
    return path.with_name(
        f".{path.name[:100]}.{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(8)}.tmp"
    )


def remove_leftovers(folder: Path) -> None:
    """Delete temporary files, also in subfolders, of processes of this machine that have ended.

    Keeps those of other machines.
    """
    ours = re.compile(rf"\..*\.{re.escape(socket.gethostname())}-([0-9]+)-[^-]*\.tmp")
    for path in folder.rglob(".*.tmp"):
        match = ours.fullmatch(path.name)
        if match is not None and not is_running(int(match[1])):
            path.unlink(missing_ok=True)


def is_running(pid: int) -> bool:
    """Whether a process with this id runs on this machine."""
    import psutil  # imported lazily: reading files does not need it

    return bool(psutil.pid_exists(pid))


@contextmanager
def locked(folder: Path, name: str = LOCK, *, wait: bool = False) -> Iterator[None]:
    """Hold the lock `name` of a folder. A missing folder is created, and removed again if it stays empty.

    The operating system releases the lock when the process ends, however it ends. Raises InputError if
    another run holds it, unless wait=True.
    """
    from filelock import FileLock, Timeout  # imported lazily: reading files needs no lock

    check_writable(folder)
    made = not folder.exists()
    path = folder / name
    with writing(path):
        folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path, timeout=-1 if wait else 0)
    try:
        with writing(path):
            try:
                lock.acquire()
            except Timeout:
                raise InputError(
                    f"another run is writing to {folder}: wait until it is done, or give another folder."
                ) from None
        try:
            yield
        finally:
            # While the lock is held: who locks a deleted file tries again. Windows deletes no open file.
            with suppress(PermissionError):
                path.unlink(missing_ok=True)
            lock.release()
    finally:
        if made:
            with suppress(OSError):  # it holds files
                folder.rmdir()


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
