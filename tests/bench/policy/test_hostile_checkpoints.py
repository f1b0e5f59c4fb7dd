"""Hostile checkpoints are refused in a sentence, with bounded memory, and run nothing."""

from __future__ import annotations

import io
import pickle
import random
import tracemalloc
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.bench.policy.test_hostile_bundles import RAN, Payload
from xmarl_bench.errors import InputError
from xmarl_bench.policy.convert import MAX_DEPTH, MAX_NAME, MAX_VISITS, read_tensors

BOUND = 256 * 2**20  # bytes that Python may allocate for a file of some kilobytes


def saved(value: object) -> bytes:
    file = io.BytesIO()
    torch.save(value, file)
    return file.getvalue()


def with_pickle(data: bytes) -> bytes:
    """A file of torch.save whose pickle is `data`."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(saved({"a": torch.zeros(4)}))) as good, zipfile.ZipFile(file, "w") as bad:
        for member in good.infolist():
            bad.writestr(member.filename, data if member.filename.endswith("data.pkl") else good.read(member))
    return file.getvalue()


def called(name: str, *arguments: int) -> bytes:
    """A pickle that calls `module name` with integers."""
    pushed = b"".join(b"\x8a\x08" + each.to_bytes(8, "little") for each in arguments)
    return b"\x80\x02c" + name.replace(" ", "\n").encode() + b"\n(" + pushed + b"tR."


def doubled(levels: int) -> dict[str, Any]:
    """2 ** levels paths to one tensor."""
    value: Any = {"a": torch.zeros(1)}
    for _ in range(levels):
        value = {"a": value, "b": value}
    return value  # type: ignore[no-any-return]


def nested(levels: int) -> Any:
    value: Any = torch.zeros(1)
    for _ in range(levels):
        value = {"a": value}
    return value


def holds_itself() -> dict[str, Any]:
    value: dict[str, Any] = {}
    value["a"] = value
    return value


REFUSED = {
    "shared dicts": saved(doubled(28)),
    "deep": saved(nested(MAX_DEPTH + 1)),
    "cycle": saved(holds_itself()),
    "wide": saved(dict.fromkeys(range(MAX_VISITS + 1), 0)),
    "name": saved({"n" * (MAX_NAME + 1): torch.zeros(1)}),
    "code": with_pickle(pickle.dumps({"a": Payload()}, protocol=2)),
    **{
        name: with_pickle(called(name, 8 * 2**30))
        for name in ("builtins bytearray", "__builtin__ bytearray", "torch FloatTensor", "torch Tensor",
                     "torch DoubleTensor", "torch.storage UntypedStorage", "torch UntypedStorage")
    },
}  # fmt: skip


def refusal(path: Path) -> str | None:
    """The sentence if the file is refused; its memory is bounded either way."""
    tracemalloc.start()
    try:
        read_tensors(path)
    except InputError as error:
        assert "\n" not in str(error)
        return str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < BOUND
        assert not RAN
    return None


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in ("shared dicts", "wide") else name
        for name in REFUSED
    ],
)
def test_what_would_take_memory_time_or_run_code_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / "model.pt"
    path.write_bytes(REFUSED[name])
    message = refusal(path)
    assert message is not None
    assert "save the state dict" in message


def mutated(rng: random.Random) -> Iterator[bytes]:
    """A file with bytes changed, cut or repeated; or a pickle of a file changed that way."""
    good = saved({"model": {"a": torch.arange(6.0), "b": torch.zeros(2, 3)}, "epoch": 3})
    with zipfile.ZipFile(io.BytesIO(good)) as archive:
        text = next(archive.read(name) for name in archive.namelist() if name.endswith("data.pkl"))
    while True:
        inner = rng.random() < 0.7
        data = bytearray(text if inner else good)
        for _ in range(rng.randint(1, 6)):
            k = rng.randrange(len(data))
            match rng.randrange(3):
                case 0:
                    data[k] = rng.randrange(256)
                case 1:
                    del data[k : k + rng.randint(1, 8)]
                case 2:
                    data[k:k] = data[rng.randrange(len(data)) :][: rng.randint(1, 8)]
        yield with_pickle(bytes(data)) if inner else bytes(data)


@pytest.mark.slow
def test_300_mutated_checkpoints_are_read_or_refused_in_a_sentence(tmp_path: Path) -> None:
    files, refused = mutated(random.Random(0)), 0
    for k in range(300):
        path = tmp_path / f"{k}.pt"
        path.write_bytes(next(files))
        refused += refusal(path) is not None
    assert 150 < refused < 300  # some mutations change a name or a value only
