"""The cache: a folder of pieces, each a file named by the hash of everything that its result depends on.

So a piece is always valid for its name, can be shared by all runs, and can be deleted at any time. A file
begins with the sha256 of the rest: a truncated or changed file counts as missing.
"""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from xmarl_bench.errors import InputError
from xmarl_bench.records.files import remove_leftovers, write_atomically

DEFAULT_FOLDER = Path(".xmarl-bench")
VERSION_DIGITS = 16  # the first digits of a key identify the version of the harness
RUNS = "runs"  # folder of the records of runs
MARKS = {
    "CACHEDIR.TAG": b"Signature: 8a477f597d28d172789f06886806bc55\n# Cache of xmarl-bench.\n",
    ".gitignore": b"*\n",
}
OURS = re.compile(f"{RUNS}|[0-9a-f]{{{VERSION_DIGITS}}}|[0-9a-f]{{2}}")  # the last: of older versions


@dataclass(frozen=True)
class Size:
    pieces: int
    size: int  # bytes
    of_version: int  # pieces of one version of the harness


class Cache:
    """Pieces by key, of 64 hexadecimal digits, and the errors of pieces that failed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def prepare(self) -> None:
        """Create the folder, mark it as a cache (https://bford.info/cachedir) that git ignores, and delete
        leftovers of killed runs."""
        for name, text in MARKS.items():
            if not (self.folder / name).exists():
                write_atomically(self.folder / name, text)
        remove_leftovers(self.folder)

    def has(self, key: str) -> bool:
        return self.read(key) is not None

    def read(self, key: str) -> bytes | None:
        """The piece; None if it is missing, truncated or changed."""
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
        """Write a piece. Raises InputError if it cannot be written."""
        write_atomically(self.path(key), _digest(value) + b"\n" + value, sync=False)
        self.failure_path(key).unlink(missing_ok=True)

    def remove(self, key: str) -> None:
        self.path(key).unlink(missing_ok=True)

    def fail(self, key: str, error: str) -> None:
        """Record why a piece failed. The next run that needs it tries again."""
        write_atomically(self.failure_path(key), error.encode())

    def failure(self, key: str) -> str | None:
        try:
            return self.failure_path(key).read_text(encoding="utf-8")
        except OSError:
            return None

    def path(self, key: str) -> Path:
        version, rest = key[:VERSION_DIGITS], key[VERSION_DIGITS:]
        return self.folder / version / rest[:2] / rest

    def failure_path(self, key: str) -> Path:
        return self.path(key).with_suffix(".failed")

    def size(self, version: str) -> Size:
        """The size of the cache. version: the beginning of a version's keys."""
        found = self.folder.glob("*/*/*") if self._is_marked() else ()
        pieces = [path for path in found if re.fullmatch("[0-9a-f]+", path.name)]
        of_version = sum(path.parent.parent.name == version for path in pieces)
        return Size(len(pieces), sum(path.stat().st_size for path in pieces), of_version)

    def clear(self) -> None:
        """Delete the cache's files, and the folder if nothing else is in it."""
        for path in self._contents():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _contents(self) -> Iterator[Path]:
        """The cache's files and folders; none if the folder is not marked as a cache."""
        if self._is_marked():
            yield from (path for path in self.folder.glob("*/") if OURS.fullmatch(path.name))
            yield from (self.folder / name for name in MARKS if (self.folder / name).exists())

    def _is_marked(self) -> bool:
        return (self.folder / "CACHEDIR.TAG").is_file()


class Memory(Cache):
    """Pieces in memory, which no other process can read or change: of runs that keep nothing."""

    def __init__(self) -> None:
        super().__init__(Path("memory"))
        self._pieces: dict[str, bytes] = {}

    def prepare(self) -> None:
        """Nothing to prepare."""

    def read(self, key: str) -> bytes | None:
        return self._pieces.get(key)

    def write(self, key: str, value: bytes) -> None:
        self._pieces[key] = value

    def remove(self, key: str) -> None:
        self._pieces.pop(key, None)

    def fail(self, key: str, error: str) -> None:
        """Errors are not kept."""


def _digest(value: bytes) -> bytes:
    return hashlib.sha256(value).hexdigest().encode()
