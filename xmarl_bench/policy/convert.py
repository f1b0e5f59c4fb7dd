"""Converts weights saved by other tools to a bundle, without executing anything in their files.

Formats: a state dict written by `torch.save` (read with `weights_only=True`, which loads tensors and plain
containers only), safetensors, and a stable-baselines3 zip of `xmarl-train`. The zip's `policy.pth` is a state
dict, and its `data` holds the architecture as plain JSON; its pickles are never read.

A key map renames tensors. It maps a prefix of their names to a new prefix, or to null for tensors to drop;
the longest matching prefix counts. New names are those of `weight_shapes`: `encoder.<k>.*`, `layers.<k>.*`
(with torch_geometric's names), `memory.*` (torch's) and `decoder.<k>.*`, or `gat.*` for the one layer of an
`Architecture`. Names that are ours but for one prefix need no map. An actor of TorchRL is a
`LayeredArchitecture` whose `scale` is "torchrl"; xmarl_bench.policy.benchmarl reads those of BenchMARL.
"""

from __future__ import annotations

import io
import json
import pickle
import pickletools
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import torch
from pydantic import TypeAdapter
from safetensors import SafetensorError
from safetensors.torch import load as load_safetensors
from torch import Tensor

from xmarl_bench.counted import first_of
from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import Architecture, BundledArchitecture, LayeredArchitecture
from xmarl_bench.policy.card import parse_record
from xmarl_bench.policy.shapes import weight_shapes
from xmarl_bench.policy.untrusted import read_file
from xmarl_bench.policy.wrapped import plain_name
from xmarl_bench.records.strict_json import parse_json, shown

SHOWN = 8  # names that a message lists
MAX_BYTES = 512 * 1024 * 1024  # of a whole checkpoint, with critic and optimiser
MAX_PICKLE = 4 * 1024 * 1024  # of the list of tensors, without their values
ALLOCATES = re.compile(r"\S+ (bytearray|\w*Tensor|UntypedStorage|TypedStorage|_rebuild_wrapper_subclass)")
MAX_VISITS, MAX_DEPTH, MAX_NAME = 100_000, 32, 1000  # of a file's nested dicts
SB3_WEIGHTS, SB3_DATA = "policy.pth", "data"
SB3_KEYS: Final[Mapping[str, str | None]] = {"actor.": "", "critic.": None}

# What zipfile and safetensors raise for damaged files.
UNREADABLE = (
    zipfile.BadZipFile, SafetensorError, zlib.error, EOFError, RuntimeError, ValueError, OverflowError,
    struct.error, OSError,
)  # fmt: skip
KeyMap = Mapping[str, str | None]
Record = Architecture | LayeredArchitecture
_RECORD: TypeAdapter[Record] = TypeAdapter(BundledArchitecture)
_KEY_MAP: TypeAdapter[dict[str, str | None]] = TypeAdapter(dict[str, str | None])


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Every tensor of a file by name; nested dicts give names `outer.inner`. Raises InputError."""
    data = read_file(path, MAX_BYTES)
    try:
        if path.suffix == ".safetensors":
            return load_safetensors(data)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if SB3_WEIGHTS in archive.namelist():
                data = _member(archive, SB3_WEIGHTS, MAX_BYTES)
        return dict(_flat(_torch_load(data, path), path))
    except InputError:
        raise
    except UNREADABLE as error:
        raise InputError(
            f"{path} is neither safetensors nor a file of torch.save or stable-baselines3 ({shown(error)}): "
            f"give a file in one of these formats."
        ) from None


def sb3_architecture(path: Path, tensors: Mapping[str, Tensor]) -> Record | None:
    """The architecture that a stable-baselines3 zip of `xmarl-train` records; None for any other file.

    tensors: those of the file. Its JSON does not hold `obs_dim`, so their shapes give it.
    """
    data = read_file(path, MAX_BYTES)
    if not zipfile.is_zipfile(io.BytesIO(data)):
        return None
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if not {SB3_WEIGHTS, SB3_DATA} <= set(archive.namelist()):
            return None
        text = _member(archive, SB3_DATA, 16 * 1024 * 1024)
    try:
        record = parse_json(text)["policy_kwargs"]["architecture"]
        actor = rename(tensors, SB3_KEYS)
        first = actor.get("encoder.0.weight", actor.get("gat.lin_l.weight"))
        assert first is not None
        return Architecture.model_validate_json(json.dumps({**record, "obs_dim": first.shape[1]}))
    except (ValueError, KeyError, TypeError, AssertionError, IndexError):
        raise InputError(f"{path} is not a checkpoint of xmarl-train: give --architecture.") from None


def read_architecture(path: Path) -> Record:
    """Read an architecture record from JSON. Raises InputError if it is invalid."""
    return parse_record(_RECORD, "an architecture", read_file(path, 1024 * 1024), str(path))


def read_key_map(path: Path) -> KeyMap:
    """Read a key map from JSON: an object of strings and nulls. Raises InputError if it is invalid."""
    what = "a key map of prefixes to prefixes or null"
    return parse_record(_KEY_MAP, what, read_file(path, 1024 * 1024), str(path))


def renamed_weights(
    path: Path, tensors: Mapping[str, Tensor], record: Record | None, key_map: Path | None
) -> tuple[Record, dict[str, Tensor]]:
    """(architecture, the file's tensors by the names of `weight_shapes`).

    record: None for that of a checkpoint of `xmarl-train`. key_map: None for a prefix that is recognised.
    Raises InputError if a file is invalid, or without architecture.
    """
    recorded = sb3_architecture(path, tensors) if record is None else None
    record = record or recorded
    if record is None:
        raise InputError(f"{path} does not hold an architecture: give --architecture.")
    if key_map is not None:
        return record, rename(tensors, read_key_map(key_map))
    if recorded is not None:
        return record, rename(tensors, SB3_KEYS)
    return record, recognised(tensors, weight_shapes(record))


def rename(tensors: Mapping[str, Tensor], key_map: KeyMap) -> dict[str, Tensor]:
    """The tensors that the map keeps, by their new names.

    Raises InputError if no prefix matches a name, if two names become the same, and for tensors that do not
    hold dense floating-point numbers.
    """
    renamed: dict[str, Tensor] = {}
    for name, tensor in tensors.items():
        fitting = [prefix for prefix in key_map if name.startswith(prefix)]
        if not fitting:
            raise InputError(
                f"no prefix of the key map matches tensor {shown(name)}: add one, mapped to a prefix or null."
            )
        prefix = max(fitting, key=len)
        start = key_map[prefix]
        if start is None:
            continue
        ours = start + name.removeprefix(prefix)
        if ours in renamed:
            raise InputError(f"the key map names two tensors {shown(ours)}: map them to different names.")
        if not tensor.is_floating_point() or tensor.layout != torch.strided or tensor.is_meta:
            raise InputError(
                f"tensor {shown(name)} does not hold dense floating-point numbers: map it to null."
            )
        renamed[ours] = tensor
    return renamed


def recognised(tensors: Mapping[str, Tensor], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Tensor]:
    """The tensors of `shapes`, found without a key map: their names may all begin with one prefix.

    Parts of names that torch's wrappers add do not count (see xmarl_bench.policy.wrapped). Tensors without
    the prefix, such as a critic's, are dropped. Raises InputError if tensors are missing, if others have the
    prefix too, and if several prefixes fit; it gives the names in the file, which a key map takes.
    """
    in_file = {plain_name(name): name for name in tensors}
    if len(in_file) < len(tensors):
        raise InputError("the file holds two networks with the same names: choose one with --key-map.")
    prefixes = {
        name.removesuffix(ours) for name in in_file for ours in shapes if f".{name}".endswith(f".{ours}")
    }
    held = {prefix: sum(prefix + ours in in_file for ours in shapes) for prefix in sorted(prefixes)} or {
        "": 0
    }
    prefix = max(held, key=lambda each: held[each])
    whole = [each for each in held if held[each] == len(shapes)]
    if len(whole) > 1:
        first = next(iter(shapes))
        starts = [shown(in_file[each + first].removesuffix(first)) for each in whole]
        raise InputError(f"networks {', '.join(starts)} all fit: choose one with --key-map.")
    others = [
        name
        for plain, name in in_file.items()
        if plain.startswith(prefix) and plain.removeprefix(prefix) not in shapes
    ]
    if not whole:
        missing = [f"{ours} {shape}" for ours, shape in shapes.items() if prefix + ours not in in_file]
        raise InputError(
            f"the file lacks {len(missing)} of {len(shapes)} tensors of the architecture, {_some(missing)}; "
            f"it holds {_some(others) or 'no others'}: rename them with --key-map."
        )
    if others:
        raise InputError(
            f"the architecture has no tensor {_some(others)}: correct it, or map them to null with --key-map."
        )
    return rename({ours: tensors[in_file[prefix + ours]] for ours in shapes}, {"": ""})


def dense(tensors: Mapping[str, Tensor], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Tensor]:
    """Tensors with the expected shape as copies in float32, the others unchanged.

    A tensor may claim any size over a few bytes (strides of 0), so only those with the right shape are
    copied. Raises InputError for NaN and infinity.
    """
    copied = dict(tensors)
    for name, shape in shapes.items():
        if name in tensors and tuple(tensors[name].shape) == shape:
            copied[name] = tensors[name].detach().float().contiguous().clone()
            if not bool(torch.isfinite(copied[name]).all()):
                raise InputError(f"tensor {name!r} holds NaN or infinity: give finite weights.")
    return copied


def _torch_load(data: bytes, path: Path) -> Any:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        pickles = [member for member in members if member.filename.endswith("data.pkl")]
        stored = all(member.compress_type == zipfile.ZIP_STORED for member in members)
        if not stored or any(member.file_size > MAX_PICKLE for member in pickles):
            raise InputError(f"{path} is not a file of torch.save: save the state dict again.")
        try:
            for member in pickles:
                _check_pickle(archive.read(member))
            return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
        except (
            pickle.UnpicklingError,
            RuntimeError,
            ValueError,
            TypeError,
            KeyError,
            AttributeError,
            IndexError,
        ):
            raise InputError(
                f"{path} holds more than tensors and plain containers, or is damaged: save the state dict "
                f"alone, torch.save(model.state_dict(), ...)."
            ) from None


def _check_pickle(data: bytes) -> None:
    """Raise UnpicklingError if the pickle names a class that makes memory of any size from a number.

    torch's reader allows them. It knows GLOBAL alone of the opcodes that name something.
    """
    for code, argument, _ in pickletools.genops(data):
        if code.name == "GLOBAL" and ALLOCATES.fullmatch(str(argument)):
            raise pickle.UnpicklingError(f"names {argument}")


def _flat(value: Any, path: Path) -> Iterator[tuple[str, Tensor]]:
    """Tensors by name. Raises InputError for dicts nested too deep, or that hold themselves or too much."""
    visits, waiting = 0, [("", value, 0)]
    while waiting:
        prefix, each, depth = waiting.pop()
        visits += 1
        if visits > MAX_VISITS or depth > MAX_DEPTH or len(prefix) > MAX_NAME:
            raise InputError(
                f"{path} holds more than {MAX_VISITS} values, {MAX_DEPTH} levels, or names of {MAX_NAME} "
                f"characters: save the state dict alone."
            )
        if isinstance(each, Tensor):
            yield prefix, each
        elif isinstance(each, Mapping):
            if len(each) > MAX_VISITS:
                raise InputError(f"{path} holds more than {MAX_VISITS} values: save the state dict alone.")
            inner = [
                (f"{prefix}.{key}" if prefix else str(key), held, depth + 1) for key, held in each.items()
            ]
            waiting += reversed(inner)


def _member(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    with archive.open(name) as file:
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise InputError(f"{name} of the zip is larger than {max_bytes} bytes: give a smaller checkpoint.")
    return data


def _some(names: list[str]) -> str:
    return first_of([shown(name).strip("'") for name in names], SHOWN)
