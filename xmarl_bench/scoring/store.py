"""Finished work, in files: each result is one file, named by the hash of all that it depends on.

So a result is never wrong for what asks for it, may be shared by runs of any kind, and a folder of them may
be deleted at any time. A file begins with the sha256 of what follows: one that was cut short or changed
counts as missing.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from xmarl_bench.errors import InputError
from xmarl_bench.records.files import remove_leftovers, write_atomically

DEFAULT_FOLDER = Path(".xmarl-bench")
TAG = b"Signature: 8a477f597d28d172789f06886806bc55\n# Finished work of xmarl-bench: delete it at will.\n"


class Store:
    """A folder of results by key, each 64 hexadecimal digits, and of the errors of what failed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def prepare(self) -> None:
        """Make the folder, mark it as a cache (https://bford.info/cachedir) that no repository wants, and
        take away what killed runs left in it."""
        for name, text in (("CACHEDIR.TAG", TAG), (".gitignore", b"*\n")):
            if not (self.folder / name).exists():
                write_atomically(self.folder / name, text)
        for folder in (self.folder, *self.folder.glob("*/")):
            remove_leftovers(folder)

    def has(self, key: str) -> bool:
        return self.read(key) is not None

    def read(self, key: str) -> bytes | None:
        """None where there is no such result, or no whole one."""
        try:
            data = self.path(key).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(
                f"{self.path(key)} cannot be read ({error.strerror}): delete it, or give another folder."
            ) from error
        digest, _, value = data.partition(b"\n")
        return value if digest == _digest(value) else None

    def write(self, key: str, value: bytes) -> None:
        """Raises InputError where it cannot be written."""
        write_atomically(self.path(key), _digest(value) + b"\n" + value, sync=False)
        self.failure_path(key).unlink(missing_ok=True)

    def remove(self, key: str) -> None:
        self.path(key).unlink(missing_ok=True)

    def fail(self, key: str, error: str) -> None:
        """Record why it could not be computed; it is tried again by the next run that wants it."""
        write_atomically(self.failure_path(key), error.encode())

    def failure(self, key: str) -> str | None:
        try:
            return self.failure_path(key).read_text()
        except OSError:
            return None

    def path(self, key: str) -> Path:
        return self.folder / key[:2] / key

    def failure_path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}.failed"


def _digest(value: bytes) -> bytes:
    return hashlib.sha256(value).hexdigest().encode()
