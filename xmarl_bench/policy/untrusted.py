"""Reads the files of a policy that may be hostile: bytes in bounded memory, and what they claim to hold.

Nothing is unpacked to disk, no link is followed out of the folder, nothing is unpickled. No torch is needed.
"""

from __future__ import annotations

import math
import os
import stat
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from xmarl_bench.errors import InputError
from xmarl_bench.records.strict_json import parse_json, shown

WEIGHTS, CARD = "policy.safetensors", "policy.json"
MAX_BYTES = {WEIGHTS: 68 * 1024 * 1024, CARD: 1024 * 1024}
MAX_HEADER = 1024 * 1024
TEXT = (".md", ".txt", "LICENSE")  # may lie beside the two in a zip


def read_member(bundle: Path, name: str) -> bytes:
    """`policy.json` or `policy.safetensors` of a bundle: a folder, or a zip of the two. Raises InputError."""
    if bundle.suffix == ".zip":
        return _from_zip(bundle, name)
    return read_file(bundle / name, MAX_BYTES[name])


def read_file(path: Path, max_bytes: int) -> bytes:
    """A regular file that is no link, of at most `max_bytes`; devices and pipes are not waited for."""
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    except OSError as error:
        why = "it is a symbolic link" if path.is_symlink() else str(error.strerror)
        raise InputError(f"{path} cannot be read ({why}): give the folder of a policy.") from None
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise InputError(f"{path} is no regular file: give the folder of a policy.")
    with os.fdopen(handle, "rb") as file:
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise InputError(f"{path} is larger than {max_bytes} bytes: that is no policy of this format.")
    return data


def _from_zip(path: Path, name: str) -> bytes:
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            _check_members(path, members)
            data = b""
            for member in members:
                if member.filename == name:
                    with archive.open(member) as file:  # its declared size is only a claim
                        data = file.read(MAX_BYTES[name] + 1)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give a policy's bundle.") from None
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, zlib.error) as error:
        raise InputError(f"{path} is no zip that can be read ({shown(error)}): pack it again.") from None
    if not data:
        raise InputError(f"{path} holds no {name}: pack {CARD} and {WEIGHTS} into it.")
    if len(data) > MAX_BYTES[name]:
        raise InputError(f"{path} holds a {name} of more than {MAX_BYTES[name]} bytes: that is no policy.")
    return data


def _check_members(path: Path, members: list[zipfile.ZipInfo]) -> None:
    """A bundle is the two files and text about them: anything else is refused, read or not."""
    names = [member.filename for member in members]
    if len(names) != len(set(names)):
        raise InputError(f"{path} holds one name twice: pack it again.")
    for member in members:
        parts = PurePosixPath(member.filename).parts
        text = member.filename.endswith(TEXT)
        link = stat.S_ISLNK(member.external_attr >> 16)
        if len(parts) != 1 or link or not (member.filename in MAX_BYTES or text):
            raise InputError(
                f"{path} holds {shown(member.filename)}: a policy's zip holds {CARD} and {WEIGHTS} at its "
                f"top, and text."
            )


def check_weights(data: bytes, expected: Mapping[str, tuple[int, ...]], where: str) -> None:
    """Compare what a safetensors file claims with what the architecture needs, before a tensor is made.

    Raises InputError for a header that lies about its length, is no strict JSON, names other tensors, shapes
    or types than float32, or gives them other stretches of the file than all of it, one after the other.
    """
    if len(data) < 8:
        raise InputError(f"{where} cannot be read as safetensors (it has {len(data)} bytes): save it again.")
    (length,) = struct.unpack("<Q", data[:8])
    if length > min(MAX_HEADER, len(data) - 8):
        raise InputError(
            f"{where} cannot be read as safetensors (a header of {length} bytes is claimed, {len(data) - 8} "
            f"are there): save it again."
        )
    try:
        header = parse_json(data[8 : 8 + length], max_bytes=MAX_HEADER)
    except ValueError as error:
        raise InputError(
            f"{where} cannot be read as safetensors (its header {error}): save it again."
        ) from None
    if not isinstance(header, dict):
        raise InputError(f"{where} cannot be read as safetensors (its header is no object): save it again.")
    tensors = {name: claim for name, claim in header.items() if name != "__metadata__"}
    shapes = {name: _claimed_shape(name, claim, where) for name, claim in tensors.items()}
    problem = misfit(dict(expected), shapes)
    if problem is not None:
        raise InputError(f"{where} does not fit the architecture in {CARD}: {problem}.")
    position = 0
    for name, claim in sorted(tensors.items(), key=lambda item: item[1]["data_offsets"]):
        end = position + 4 * math.prod(shapes[name])
        if claim["data_offsets"] != [position, end]:
            raise InputError(
                f"{where} has tensor {shown(name)} at another place than it fills: save it again."
            )
        position = end
    if position != len(data) - 8 - length:
        raise InputError(
            f"{where} cannot be read as safetensors (it holds {len(data) - 8 - length} bytes of tensors and "
            f"claims {position}): save it again."
        )


def misfit(expected: dict[str, tuple[int, ...]], received: dict[str, tuple[int, ...]]) -> str | None:
    """The first tensor whose shape is another, is missing or is too much, as a clause; None where all fit."""
    for name in sorted(expected.keys() | received.keys()):
        if expected.get(name) != received.get(name):
            shape = str(received.get(name))[:80]
            return f"tensor {name[:80]!r} has shape {shape}, expected {expected.get(name)}"
    return None


def _claimed_shape(name: str, claim: Any, where: str) -> tuple[int, ...]:
    in_order = (
        isinstance(claim, dict)
        and claim.keys() == {"dtype", "shape", "data_offsets"}
        and claim["dtype"] == "F32"
        and all(isinstance(claim[key], list) for key in ("shape", "data_offsets"))
        and all(type(n) is int and n >= 0 for key in ("shape", "data_offsets") for n in claim[key])
        and len(claim["data_offsets"]) == 2
    )
    if not in_order:
        raise InputError(
            f"{where} describes tensor {shown(name)} in another way than float32 weights are: save it again."
        )
    return tuple(claim["shape"])
