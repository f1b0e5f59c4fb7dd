"""Reads the files of a bundle, a folder or a zip, as bytes, in bounded memory and time.

Unpacks nothing: names are untrusted, so they are compared with a closed list and never become paths. Sizes in
headers are untrusted too, so bytes are counted as they are read.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from xmarl_bench.errors import InputError
from xmarl_bench.policy.untrusted import CARD, MAX_BYTES, WEIGHTS
from xmarl_bench.records.field_types import RESERVED
from xmarl_bench.records.strict_json import MAX_BYTES as MAX_JSON
from xmarl_bench.records.strict_json import printable, shown

MANIFEST: Final = "manifest.json"
_NAME = r"[a-z0-9][a-z0-9._-]{0,99}"
# The files that a bundle may hold, with their largest size. Lower case, so that no two differ in case only.
KINDS: dict[str, tuple[re.Pattern[str], int]] = {
    "manifest": (re.compile(r"manifest\.json"), 1024 * 1024),
    "licence": (re.compile(r"LICENSE"), 256 * 1024),
    "readme": (re.compile(r"README\.md"), 256 * 1024),
    "entry": (re.compile(r"entries/[a-z0-9][a-z0-9._-]{0,250}\.json"), MAX_JSON),
    "rows": (re.compile(r"rows/[a-z0-9][a-z0-9._-]{0,250}\.csv"), MAX_JSON),
    "card": (re.compile(rf"policies/{_NAME}/{re.escape(CARD)}"), MAX_BYTES[CARD]),
    "weights": (re.compile(rf"policies/{_NAME}/{re.escape(WEIGHTS)}"), MAX_BYTES[WEIGHTS]),
}
MAX_FILES, MAX_TOTAL = 1000, 128 * 1024 * 1024
MAX_ZIP, MAX_DIRECTORY = 128 * 1024 * 1024, 256 * 1024
_END, _END_SIZE = b"PK\x05\x06", 22


def is_bundle(path: Path) -> bool:
    """Whether a path is a bundle, not entries."""
    return path.suffix == ".zip" or (path / MANIFEST).is_file()


def kind_of(name: str) -> str | None:
    """The kind of a file, of KINDS, by its name; None if bundles hold no such file."""
    if any(RESERVED.fullmatch(part) for part in name.split("/")):
        return None
    return next((kind for kind, (pattern, _) in KINDS.items() if pattern.fullmatch(name)), None)


def read_files(path: Path) -> dict[str, bytes]:
    """Every file of a bundle, by its name with forward slashes.

    Raises InputError if the path is neither a folder nor a zip, or cannot be read; ValueError, with a
    sentence, for files that a bundle may not hold, and for too many files or bytes.
    """
    files: dict[str, bytes] = {}
    total = 0
    for name, data in _folder(path) if path.is_dir() else _zip(path):
        total += len(data)
        if name in files:
            raise ValueError(f"it holds {shown(name)} twice: pack it again.")
        if len(files) >= MAX_FILES or total > MAX_TOTAL:
            raise ValueError(
                f"it holds more than {MAX_FILES} files or {MAX_TOTAL} bytes: make several bundles."
            )
        files[name] = data
    return files


def limit(name: str) -> int:
    """The largest size of a file, in bytes. Raises ValueError if bundles hold no such file."""
    kind = kind_of(name)
    if kind is None:
        raise ValueError(f"it holds {shown(name)}, which is not a file of a bundle: remove it.")
    return KINDS[kind][1]


def _checked(name: str, data: bytes) -> tuple[str, bytes]:
    if len(data) > limit(name):
        raise ValueError(f"its {shown(name)} holds more than {limit(name)} bytes.")
    return name, data


def _folder(path: Path) -> Iterator[tuple[str, bytes]]:
    seen = 0
    for folder, folders, names in os.walk(path, onerror=_unreadable):
        folders.sort()
        for name in [*folders, *sorted(names)]:
            seen += 1
            if seen > 2 * MAX_FILES:
                raise ValueError(f"it holds more than {MAX_FILES} files.")
            file = Path(folder) / name
            mode = file.lstat().st_mode
            relative = file.relative_to(path).as_posix()
            if stat.S_ISREG(mode):
                with file.open("rb") as opened:
                    yield _checked(relative, opened.read(limit(relative) + 1))
            elif not stat.S_ISDIR(mode):
                raise ValueError(f"it holds {shown(relative)}, a link or special file: remove it.")


def _unreadable(error: OSError) -> None:
    raise error


def _zip(path: Path) -> Iterator[tuple[str, bytes]]:
    size = path.stat().st_size
    if size > MAX_ZIP:
        raise ValueError(f"it holds more than {MAX_ZIP} bytes.")
    try:
        with path.open("rb") as file:
            _check_directory(file.read())
            archive = zipfile.ZipFile(file)
            for member in archive.infolist():
                if member.is_dir():
                    continue
                name = member.orig_filename  # zipfile changes `filename` to look harmless
                if stat.S_IFMT(member.external_attr >> 16) not in (0, stat.S_IFREG):
                    raise ValueError(f"it holds {shown(name)}, a link or special file: remove it.")
                if member.flag_bits & 1 or member.compress_type not in (
                    zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED,
                ):  # fmt: skip
                    raise ValueError(
                        f"its {shown(name)} is encrypted, or compressed with another method than deflate: "
                        f"pack it again."
                    )
                if member.compress_size > size:  # older Pythons would read what follows
                    raise zipfile.BadZipFile(f"{shown(name)} claims more bytes than the zip has")
                most = limit(name)
                with archive.open(member) as opened:
                    yield _checked(name, opened.read(most + 1))
    except (
        zipfile.BadZipFile,
        EOFError,
        NotImplementedError,
        UnicodeDecodeError,
        struct.error,
        zlib.error,
    ) as e:
        raise InputError(f"{printable(path)} is not a readable zip ({shown(e)}): pack it again.") from None


def _check_directory(data: bytes) -> None:
    """Raise an error if a zip's directory is missing or too large, before zipfile reads it."""
    end = data.rfind(_END, max(0, len(data) - _END_SIZE - 0xFFFF))
    if end < 0 or len(data) < end + _END_SIZE:
        raise zipfile.BadZipFile("it has no end record")
    size = struct.unpack_from("<I", data, end + 12)[0]
    if size > MAX_DIRECTORY or b"PK\x06\x07" in data[max(0, end - 20) : end]:
        raise ValueError(f"it lists more than {MAX_FILES} files.")
