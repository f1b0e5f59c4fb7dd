"""Hostile bundles: nothing in them runs, and each is refused with one sentence, little time and memory."""

from __future__ import annotations

import io
import json
import os
import pickle
import random
import resource
import struct
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.bench.policy.test_layers import CARD as FIELDS
from tests.bench.policy.test_layers import GAT2, random_policy, record
from tests.conftest import MakeBundle, RunCli
from xmarl_bench.errors import InputError
from xmarl_bench.policy import load_policy, save_policy, untrusted
from xmarl_bench.policy.untrusted import CARD, WEIGHTS

RAN: list[str] = []  # traces of payloads that ran
MUTATIONS = int(os.environ.get("XMARL_BENCH_MUTATIONS", "500"))


def fire() -> None:
    RAN.append("a payload ran")


class Payload:
    def __reduce__(self) -> tuple[Callable[[], None], tuple[()]]:
        return fire, ()


def refused(bundle: Path) -> str:
    """The error's one sentence; fails if the bundle loads, takes a second, or executes anything."""
    started = time.process_time()
    with pytest.raises(InputError) as error:
        load_policy(bundle)
    assert time.process_time() - started < 2.0
    assert RAN == []
    said = str(error.value)
    assert said.endswith((".", "?"))
    assert said.isprintable()
    assert len(said) < 700
    return said


def safetensors(header: object, body: bytes = b"", length: int | None = None) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if length is None else length) + text + body


def claim(shape: list[Any], dtype: str = "F32", offsets: object = (0, 4)) -> dict[str, Any]:
    return {"w": {"dtype": dtype, "shape": shape, "data_offsets": offsets}}


@pytest.mark.parametrize(
    "data",
    [
        pickle.dumps(Payload()),
        b"",
        b"\x80\x04",
        safetensors({}, length=2**63),
        safetensors({}, length=10**9),
        safetensors(b"[" * 100_000),
        safetensors(b'{"a": 1, "a": 2}'),
        safetensors(b'{"a": NaN}'),
        safetensors(b"\xff\xfe"),
        safetensors([1, 2]),
        safetensors(claim([2**62, 2**62])),
        safetensors(claim([-1])),
        safetensors(claim([1.5])),
        safetensors(claim([True])),
        safetensors(claim(["1"])),
        safetensors(claim([1], dtype="pickle"), b"1234"),
        safetensors(claim([1], offsets=[0, 10**15]), b"1234"),
        safetensors(claim([1], offsets="x"), b"1234"),
        safetensors({"w": None}),
        safetensors({f"t{k}": claim([1])["w"] for k in range(20_000)}),
    ],
    ids=range(20),
)
def test_invalid_safetensors_are_refused(make_bundle: MakeBundle, data: bytes) -> None:
    folder = make_bundle()
    (folder / WEIGHTS).write_bytes(data)
    assert WEIGHTS in refused(folder)


def test_torch_files_are_not_opened_under_any_name(make_bundle: MakeBundle, tmp_path: Path) -> None:
    buffer = io.BytesIO()
    torch.save({"gat.att": Payload()}, buffer)
    for name in (WEIGHTS, CARD):
        folder = make_bundle(name="torch-" + name)
        (folder / name).write_bytes(buffer.getvalue())
        refused(folder)
    beside = make_bundle(name="beside")
    for name in ("policy.pth", "policy.pkl", "data.pkl", "hubconf.py", "conftest.py"):
        (beside / name).write_bytes(buffer.getvalue())
    load_policy(beside)  # other files in a folder are not opened
    assert RAN == []


def test_false_offsets_of_tensors_are_refused(make_bundle: MakeBundle) -> None:
    """Every tensor fits its shape, but two share bytes, bytes remain, or there is a gap."""
    folder = make_bundle()
    data = (folder / WEIGHTS).read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
    first, second = sorted(header, key=lambda name: header[name]["data_offsets"])[:2]
    shared = {**header, second: {**header[second], "data_offsets": header[first]["data_offsets"]}}
    for wrong in (
        safetensors(shared, body),
        safetensors(header, body + b"0000"),
        safetensors(header, body[:-4]),
    ):
        (folder / WEIGHTS).write_bytes(wrong)
        assert "cannot be read as safetensors" in refused(folder) or "a wrong position" in refused(folder)


def nested(depth: int) -> bytes:
    return b'{"name": ' + b"[" * depth + b"]" * depth + b"}"


@pytest.mark.parametrize(
    "text",
    [
        nested(50_000),
        nested(400),
        b'{"name": "a", "name": "b"}',
        b'{"attention_entropy": Infinity}',
        b'{"attention_entropy": 1e999}',
        b'{"n_agents": ' + b"9" * 5000 + b"}",
        b'{"name": "\x1b[2J' + b"x" * 5000 + b'"}',
        b"[]",
        b"null",
        b"\xff",
        pickle.dumps(Payload()),
        b" " * 2_000_000,
    ],
    ids=range(12),
)
def test_invalid_cards_are_refused(make_bundle: MakeBundle, text: bytes) -> None:
    folder = make_bundle()
    (folder / CARD).write_bytes(text)
    assert CARD in refused(folder)


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "code", "obs_dim": 6, "entry_point": "os:system", "package": None, "version": None,
         "code_sha256": None, "distribution": "normal", "graph": {"kind": "complete"}},
        {"kind": "exec"},
        {"obs_dim": 10**12},
        {"encoder": [2048] * 9},
        {"encoder": [10**6]},
        {"gat_width": True},
        {"gat_width": 8.0},
        {"gat_width": "8"},
        {"decoder_activation": "__import__('os').abort"},
        {"encoder": [2048] * 8, "decoder": [2048] * 8},
        {"layers": [{"conv": "GATConv", "width": 8, "activation": "tanh"}]},
    ],
    ids=range(11),
)  # fmt: skip
def test_invalid_architectures_are_refused(make_bundle: MakeBundle, change: dict[str, Any]) -> None:
    folder = make_bundle()
    card = json.loads((folder / CARD).read_text())
    replaced = change if "entry_point" in change else {**card["architecture"], **change}
    (folder / CARD).write_text(json.dumps({**card, "architecture": replaced}))
    refused(folder)


def test_links_devices_and_pipes_are_not_followed(make_bundle: MakeBundle, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("{}")
    for name in (CARD, WEIGHTS):
        for kind in ("link", "device", "pipe", "folder"):
            folder = make_bundle(name=f"{kind}-{name}")
            (folder / name).unlink()
            if kind == "link":
                (folder / name).symlink_to(secret)
            elif kind == "device":
                (folder / name).symlink_to("/dev/zero")
            elif kind == "pipe":
                os.mkfifo(folder / name)
            else:
                (folder / name).mkdir()
            assert str(folder / name) in refused(folder)


def test_links_are_refused_where_opening_follows_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Windows, which has no O_NOFOLLOW."""
    (tmp_path / "secret").write_bytes(b"{}")
    (tmp_path / CARD).symlink_to(tmp_path / "secret")
    monkeypatch.setattr(untrusted, "NO_FOLLOW", 0)
    with pytest.raises(InputError, match="is a symbolic link: give the file that it points to"):
        untrusted.read_file(tmp_path / CARD, 10)


def zipped(path: Path, members: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def test_a_zip_of_the_two_files_is_a_bundle(make_bundle: MakeBundle, tmp_path: Path, run_cli: RunCli) -> None:
    folder = make_bundle()
    members = {name: (folder / name).read_bytes() for name in (CARD, WEIGHTS)}
    _, card = load_policy(zipped(tmp_path / "a.zip", members, zipfile.ZIP_DEFLATED))
    assert card == load_policy(folder)[1]
    load_policy(zipped(tmp_path / "b.zip", {**members, "README.md": b"hello"}))
    ran = run_cli("evaluate", "--policy", tmp_path / "a.zip", "--episodes", 1, "--max-cycles", 2)
    assert ran.code == 0, ran.err


@pytest.mark.slow
def test_invalid_zips_are_refused(make_bundle: MakeBundle, tmp_path: Path) -> None:
    folder = make_bundle()
    good = {name: (folder / name).read_bytes() for name in (CARD, WEIGHTS)}
    for k, name in enumerate(
        [
            "../evil",
            "/etc/evil",
            "a/../../evil",
            "sub/policy.json",
            "evil.pkl",
            "policy.pth",
            "..",
            "x\\y",
            "a.py",
        ]
    ):
        assert ": pack only policy.json" in refused(zipped(tmp_path / f"{k}.zip", {**good, name: b"x"})), name
    assert not (tmp_path.parent / "evil").exists()
    bomb = zipped(tmp_path / "bomb.zip", {**good, WEIGHTS: bytes(200 * 2**20)}, zipfile.ZIP_DEFLATED)
    assert bomb.stat().st_size < 2**20
    assert "more than" in refused(bomb)
    assert "no policy.safetensors" in refused(zipped(tmp_path / "half.zip", {CARD: good[CARD]}))
    (tmp_path / "text.zip").write_text("this is no zip")
    assert "not a readable zip" in refused(tmp_path / "text.zip")
    link = zipfile.ZipInfo(WEIGHTS)
    link.external_attr = 0o120777 << 16
    with zipfile.ZipFile(tmp_path / "link.zip", "w") as archive:
        archive.writestr(CARD, good[CARD])
        archive.writestr(link, "/etc/passwd")
    refused(tmp_path / "link.zip")
    with (
        zipfile.ZipFile(tmp_path / "twice.zip", "w") as archive,
        pytest.warns(UserWarning, match="Duplicate"),
    ):
        for data in (good[CARD], b"{}"):
            archive.writestr(CARD, data)
    assert "twice" in refused(tmp_path / "twice.zip")


def values(rng: random.Random) -> Any:
    return rng.choice(
        [None, True, -1, 0, 1, 7, 2048, 2049, 10**6, 10**18, 1.5, -0.0, 1e308, "", "tanh", "x" * 3000, [],
         [[]], {}, [1], [2048] * 8, [2048] * 9, {"kind": "radius"}, "GATConv", "../..",
         "\x00\x1b[31m", "os:system"]
    )  # fmt: skip


def mutated_json(data: bytes, rng: random.Random) -> bytes:
    """The JSON with one to three values replaced, removed or added."""
    value = json.loads(data)
    for _ in range(rng.randint(1, 3)):
        node = value
        while True:
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            key = rng.choice(keys) if keys else None
            if key is not None and isinstance(node[key], dict | list) and node[key] and rng.random() < 0.8:
                node = node[key]
                continue
            break
        action = rng.random()
        if key is None or action < 0.15:
            if isinstance(node, dict):
                node[rng.choice(["surprise", "__reduce__", "kind", "x" * 500])] = values(rng)
            else:
                node.append(values(rng))
        elif action < 0.3:
            del node[key]
        else:
            node[key] = values(rng)
    return json.dumps(value).encode()


def mutated_bytes(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    action = rng.random()
    if action < 0.5:
        for _ in range(rng.randint(1, 8)):
            changed[rng.randrange(min(len(changed), 600))] = rng.randrange(256)
    elif action < 0.75:
        del changed[rng.randrange(len(changed)) :]
    else:
        where = rng.randrange(len(changed))
        changed[where:where] = rng.randbytes(rng.randint(1, 40))
    return bytes(changed)


def mutated_weights(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.5:
        return mutated_bytes(data, rng)
    (length,) = struct.unpack("<Q", data[:8])
    header = mutated_json(data[8 : 8 + length], rng)
    length = len(header) if rng.random() < 0.8 else rng.choice([0, 1, 2**31, 2**63 - 1, 2**64 - 1])
    return struct.pack("<Q", length) + header + data[8 + length :]


@pytest.mark.slow
def test_mutated_bundles_are_refused_or_load_within_bounds(make_bundle: MakeBundle, tmp_path: Path) -> None:
    """Each is refused with a sentence, or loads as a policy of the bounded size in its record."""
    deep = tmp_path / "policies" / "deep"
    save_policy(
        deep, random_policy(record(GAT2, graph={"kind": "radius", "radius": 1.0})), name="deep", **FIELDS
    )
    originals = [
        (folder, {name: (folder / name).read_bytes() for name in (CARD, WEIGHTS)})
        for folder in (make_bundle(), deep)
    ]
    rng = random.Random(0)
    load_policy(deep)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    n_loaded = 0
    slowest = 0.0
    for k in range(MUTATIONS):
        folder, files = originals[k % 2]
        card, weights = files[CARD], files[WEIGHTS]
        if rng.random() < 0.6:
            card = mutated_json(card, rng) if rng.random() < 0.8 else mutated_bytes(card, rng)
        else:
            weights = mutated_weights(weights, rng)
        (folder / CARD).write_bytes(card)
        (folder / WEIGHTS).write_bytes(weights)
        started = time.process_time()
        try:
            policy, _ = load_policy(folder)
        except InputError as error:
            said = str(error)
            assert said.isprintable(), said
            assert said.endswith((".", "?")), said
            assert len(said) < 700, said
        else:
            n_loaded += 1
            assert sum(parameter.numel() for parameter in policy.parameters()) < 1000
        slowest = max(slowest, time.process_time() - started)
    assert RAN == []
    assert n_loaded < MUTATIONS / 4  # mutations of harmless fields, such as the training seed
    assert slowest < 2.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 * 1024  # kB
