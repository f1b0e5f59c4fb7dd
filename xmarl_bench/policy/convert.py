"""Weights that others saved, to a bundle, without executing anything they hold.

Read are a `torch.save`d state dict (with `weights_only=True`, which knows tensors and plain containers and
calls nothing), safetensors, and a stable-baselines3 zip of `xmarl-train`: its `policy.pth` is such a state
dict, and the architecture stands in its `data` as plain JSON; the pickles beside it are never looked at.

A key map says what tensors are called here. It maps the beginning of a name to another beginning, or to null
for what is left out; of several that fit, the longest counts. Names here are those of `weight_shapes`:
`encoder.<k>.*`, `layers.<k>.*` (as torch_geometric has them) and `decoder.<k>.*`, or `gat.*` for the one
layer of an `Architecture`. An actor of TorchRL or BenchMARL is a `LayeredArchitecture` whose `scale` is
"torchrl".
"""

from __future__ import annotations

import io
import pickle
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import torch
from pydantic import TypeAdapter, ValidationError
from safetensors import SafetensorError
from safetensors.torch import load as load_safetensors
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import Architecture, BundledArchitecture, LayeredArchitecture
from xmarl_bench.policy.untrusted import read_file
from xmarl_bench.records.strict_json import first_error, parse_json, shown

MAX_BYTES = 512 * 1024 * 1024  # of a checkpoint: critic, optimiser and all
MAX_PICKLE = 4 * 1024 * 1024  # what says which tensors there are, without their numbers
SB3_WEIGHTS, SB3_DATA = "policy.pth", "data"
SB3_KEYS: Final[Mapping[str, str | None]] = {"actor.": "", "critic.": None}

KeyMap = Mapping[str, str | None]
Record = Architecture | LayeredArchitecture
_RECORD: TypeAdapter[Record] = TypeAdapter(BundledArchitecture)
_KEY_MAP: TypeAdapter[dict[str, str | None]] = TypeAdapter(dict[str, str | None])


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Every tensor of a file by its name; those of nested dicts by `outer.inner`. Raises InputError."""
    data = read_file(path, MAX_BYTES)
    try:
        if path.suffix == ".safetensors":
            return load_safetensors(data)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if SB3_WEIGHTS in archive.namelist():
                data = _member(archive, SB3_WEIGHTS, MAX_BYTES)
        return dict(_flat(_torch_load(data, path)))
    except (zipfile.BadZipFile, NotImplementedError, SafetensorError, zlib.error, EOFError) as error:
        raise InputError(
            f"{path} is neither safetensors nor a file of torch.save or stable-baselines3 ({shown(error)})."
        ) from None


def sb3_architecture(path: Path, tensors: Mapping[str, Tensor]) -> Record | None:
    """The architecture that a stable-baselines3 zip of `xmarl-train` records; None for any other file.

    tensors: of the file. `obs_dim` is not recorded there in the clear: it is read off them.
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
        return Architecture.model_validate({**_tuples(record), "obs_dim": first.shape[1]})
    except (ValueError, KeyError, TypeError, AssertionError, IndexError):
        raise InputError(f"{path} is no checkpoint of xmarl-train: give --architecture.") from None


def read_architecture(path: Path) -> Record:
    """An architecture record as JSON. Raises InputError."""
    data = read_file(path, 1024 * 1024)
    try:
        parse_json(data)
        return _RECORD.validate_json(data)
    except ValidationError as error:
        said, where = first_error(error)
        raise InputError(
            f"{path} is no architecture: {shown(said)} at {shown(where or 'the whole file')}."
        ) from None
    except ValueError as error:
        raise InputError(f"{path} is no architecture: it {error}.") from None


def read_key_map(path: Path) -> KeyMap:
    """A key map as JSON: an object of strings and nulls. Raises InputError."""
    data = read_file(path, 1024 * 1024)
    try:
        return _KEY_MAP.validate_python(parse_json(data), strict=True)
    except ValidationError:
        raise InputError(f"{path} is no key map: map names to names, or to null.") from None
    except ValueError as error:
        raise InputError(f"{path} is no key map: it {error}.") from None


def rename(tensors: Mapping[str, Tensor], key_map: KeyMap) -> dict[str, Tensor]:
    """The tensors by their names here, as float32.

    Raises InputError for a name that nothing in the map begins, two that become one, and for tensors that
    are no floating-point numbers.
    """
    renamed: dict[str, Tensor] = {}
    for name, tensor in tensors.items():
        fitting = [prefix for prefix in key_map if name.startswith(prefix)]
        if not fitting:
            raise InputError(
                f"the key map says nothing of tensor {shown(name)}: map its beginning to a name, or to null."
            )
        prefix = max(fitting, key=len)
        start = key_map[prefix]
        if start is None:
            continue
        ours = start + name.removeprefix(prefix)
        if ours in renamed:
            raise InputError(f"the key map makes two tensors {shown(ours)}: tell them apart.")
        if not tensor.is_floating_point() or tensor.layout != torch.strided or tensor.is_meta:
            raise InputError(f"tensor {shown(name)} holds no dense floating-point numbers: leave it out.")
        renamed[ours] = tensor
    return renamed


def dense(tensors: Mapping[str, Tensor], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Tensor]:
    """Copies in float32 of the tensors whose shape is the one expected; the others as they are.

    A tensor may claim any size over a few bytes (strides of 0): it is copied once its shape is known to fit.
    Raises InputError for NaN and infinity.
    """
    copied = dict(tensors)
    for name, shape in shapes.items():
        if name in tensors and tuple(tensors[name].shape) == shape:
            copied[name] = tensors[name].detach().float().contiguous().clone()
            if not bool(torch.isfinite(copied[name]).all()):
                raise InputError(f"tensor {name!r} holds NaN or infinity: save finished weights.")
    return copied


def _torch_load(data: bytes, path: Path) -> Any:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
    stored = all(member.compress_type == zipfile.ZIP_STORED for member in members)
    small = all(m.file_size <= MAX_PICKLE for m in members if m.filename.endswith("data.pkl"))
    if not stored or not small:
        raise InputError(f"{path} is no file as torch.save writes it: save the state dict again.")
    try:
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
            f"{path} holds more than tensors and plain containers, or is damaged: save the state dict alone, "
            f"torch.save(model.state_dict(), ...)."
        ) from None


def _flat(value: Any, prefix: str = "") -> Iterator[tuple[str, Tensor]]:
    if isinstance(value, Tensor):
        yield prefix, value
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _flat(each, f"{prefix}.{key}" if prefix else str(key))


def _member(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    with archive.open(name) as file:
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise InputError(f"{name} of the zip is larger than {max_bytes} bytes: that is no checkpoint.")
    return data


def _tuples(record: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in record.items()}
