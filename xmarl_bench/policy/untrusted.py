"""Reads files of a policy that may be hostile, in bounded memory, and checks what they claim to hold.

Unpacks nothing to disk, follows no links and unpickles nothing. Does not need torch.
"""

from __future__ import annotations

import errno
import os
import stat
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from xmarl_bench.errors import InputError
from xmarl_bench.records.strict_json import parse_json, shown

WEIGHTS, CARD = "policy.safetensors", "policy.json"
MAX_BYTES = {WEIGHTS: 68 * 1024 * 1024, CARD: 1024 * 1024}
MAX_HEADER = 1024 * 1024
NO_FOLLOW: int = getattr(os, "O_NOFOLLOW", 0)
TEXT = (".md", ".txt", "LICENSE")  # further files allowed in a zip


def read_member(bundle: Path, name: str) -> bytes:
    """Read `policy.json` or `policy.safetensors` of a bundle, a folder or a zip. Raises InputError."""
    if bundle.suffix == ".zip":
        return _from_zip(bundle, name)
    return read_file(bundle / name, MAX_BYTES[name], "give the folder of a policy")


def read_file(path: Path, max_bytes: int, what_to_do: str = "give another file") -> bytes:
    """Read a regular file of at most `max_bytes`. Raises InputError for links, devices and pipes."""
    try:
        if NO_FOLLOW == 0 and path.is_symlink():  # Windows opens the target
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
        handle = os.open(path, os.O_RDONLY | NO_FOLLOW | getattr(os, "O_NONBLOCK", 0))
    except OSError as error:
        if path.is_symlink():
            raise InputError(f"{path} is a symbolic link: give the file that it points to.") from None
        raise InputError(f"{path} cannot be read ({error.strerror}): {what_to_do}.") from None
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise InputError(f"{path} is not a regular file: {what_to_do}.")
    with os.fdopen(handle, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(min(size, max_bytes) + 1)  # reading takes as much memory as it is asked for
    if len(data) > max_bytes:
        raise InputError(f"{path} is larger than the limit of {max_bytes} bytes: give a smaller file.")
    return data


def _from_zip(path: Path, name: str) -> bytes:
    try:
        with zipfile.ZipFile(path) as archive:
            _check_members(path, archive.infolist())
            data = b""
            if name in archive.namelist():
                with archive.open(name) as file:  # its declared size may be wrong
                    data = file.read(MAX_BYTES[name] + 1)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give a policy's bundle.") from None
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, zlib.error) as error:
        raise InputError(f"{path} is not a readable zip ({shown(error)}): pack it again.") from None
    if not data:
        raise InputError(f"{path} holds no {name}: pack {CARD} and {WEIGHTS} into it.")
    if len(data) > MAX_BYTES[name]:
        raise InputError(
            f"{path} holds a {name} of more than {MAX_BYTES[name]} bytes, the limit: give a smaller policy."
        )
    return data


def _check_members(path: Path, members: list[zipfile.ZipInfo]) -> None:
    """Raise InputError if the zip holds anything but the two files and text."""
    names = [member.filename for member in members]
    if len(names) != len(set(names)):
        raise InputError(f"{path} holds two files of the same name: pack it again.")
    for member in members:
        parts = PurePosixPath(member.filename).parts
        text = member.filename.endswith(TEXT)
        link = stat.S_ISLNK(member.external_attr >> 16)
        if len(parts) != 1 or link or not (member.filename in MAX_BYTES or text):
            raise InputError(
                f"{path} holds {shown(member.filename)}: pack only {CARD}, {WEIGHTS} and text files, without "
                f"folders."
            )


def check_weights(data: bytes, expected: Mapping[str, tuple[int, ...]], where: str) -> None:
    """Compare the header of a safetensors file with the architecture, before a tensor is made.

    Raises InputError if the header is too long or not strict JSON, or if names, shapes or types (float32) of
    tensors differ. That they fill the rest of the file in sequence is checked by safetensors.
    """
    length = int.from_bytes(data[:8], "little")
    if length > MAX_HEADER:
        raise InputError(
            f"{where} cannot be read as safetensors (it claims a header of {length} bytes, more than the "
            f"limit of {MAX_HEADER}): save it again."
        )
    try:
        header = parse_json(data[8 : 8 + length], max_bytes=MAX_HEADER)
    except ValueError as error:
        raise InputError(
            f"{where} cannot be read as safetensors (its header {error}): save it again."
        ) from None
    if not isinstance(header, dict):
        raise InputError(
            f"{where} cannot be read as safetensors (its header is not an object): save it again."
        )
    header.pop("__metadata__", None)
    for name, claim in header.items():
        claimed = (claim.get("dtype"), type(claim.get("shape"))) if isinstance(claim, dict) else None
        if claimed != ("F32", list):
            raise InputError(
                f"{where} does not describe tensor {shown(name)} as float32 weights: save it again."
            )
    problem = misfit(expected, {name: tuple(claim["shape"]) for name, claim in header.items()})
    if problem is not None:
        raise InputError(f"{where} does not fit the architecture in {CARD}: {problem}.")


def misfit(expected: Mapping[str, tuple[int, ...]], received: Mapping[str, tuple[int, ...]]) -> str | None:
    """The first tensor that is missing, unknown or of another shape, as a clause; None if all fit."""
    for name in sorted(expected.keys() | received.keys()):
        if expected.get(name) != received.get(name):
            shape = str(received.get(name))[:80]
            return f"tensor {name[:80]!r} has shape {shape}, expected {expected.get(name)}"
    return None
