"""Hundreds of mutated entries and bundles are refused in sentences within two seconds of CPU time."""

from __future__ import annotations

import json
import os
import random
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.bench.submission.edits import with_id, with_manifest
from xmarl_bench.entry.file import entry_text
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.policy.card import PolicyCard
from xmarl_bench.records.files import canonical_json
from xmarl_bench.submission.archive import MANIFEST
from xmarl_bench.submission.checking import check
from xmarl_bench.submission.packing import write_bundle

pytestmark = pytest.mark.slow

SECONDS = 2.0  # of CPU time
# XMARL_BENCH_MUTATIONS=2000 tries so many of each.
ENTRIES, BUNDLES = (int(os.environ.get("XMARL_BENCH_MUTATIONS", few)) for few in (250, 60))
VALUES: list[Any] = [
    None, True, -1, 0, 10**18, 10**30, 1.5, -0.1, 1e300, "", "x", "9" * 5000, "\ud800", "\x1b[2J",
    "../../etc/passwd", [], [1], {}, {"a": 1}, [[[[[[]]]]]], ["a"] * 10_000,
]  # fmt: skip
RAW = ["NaN", "Infinity", "-Infinity", "1e999", "9" * 5000, "[" * 100_000, '{"a":' * 50_000, "nul", "'x'"]
Place = tuple[Any, ...]


def places(value: Any, path: Place = ()) -> Iterator[Place]:
    """The path of every value in a JSON document."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in items:
        yield from places(each, (*path, key))


def at(value: Any, path: Place) -> Any:
    for key in path:
        value = value[key]
    return value


def mutated(data: bytes, paths: list[Place], rng: random.Random, *, fit_id: bool = False) -> bytes:
    """The text of a JSON document with a fault at one of the places, or with two values swapped."""
    value = json.loads(data)
    path = rng.choice(paths)
    holder, key = at(value, path[:-1]), path[-1]
    kind = rng.choice(["value", "missing", "extra", "twice", "raw", "cut", "swap"])
    if kind == "cut":
        cut = rng.randrange(1, len(data) - 20)
        return data[:cut] + rng.choice([b"", b"\xff\xfe", b"}", b"\x00", data[:cut]])
    if kind == "twice" and isinstance(key, str):
        name = json.dumps(key).encode()
        return canonical_json(value).replace(name + b":", name + b":null," + name + b":", 1)
    if kind == "raw":
        holder[key] = "@@@"
        return canonical_json(value).replace(b'"@@@"', rng.choice(RAW).encode(), 1)
    if kind == "missing" and isinstance(holder, dict):
        del holder[key]
    elif kind == "extra" and isinstance(holder, dict):
        holder[rng.choice(["extra", "__class__", "$ref", "../x"])] = holder[key]
    elif kind == "swap":  # with a value of the same name in another cell, row, control or metric
        other = rng.choice([each for each in paths if each[-1] == key])
        far = at(value, other[:-1])
        holder[key], far[other[-1]] = far[other[-1]], holder[key]
    else:
        holder[key] = rng.choice(VALUES)
    return canonical_json(with_id(value) if fit_id else value)


def refused(path: Path) -> float:
    """CPU seconds until it was refused, with sentences that are safe on a terminal."""
    started = time.process_time()
    try:
        findings = check(path).findings
    except InputError as error:
        findings = [str(error)]
    seconds = time.process_time() - started
    assert findings, f"{path} was accepted"
    for finding in findings:
        assert finding.isprintable(), finding
        assert finding.endswith("."), finding
        assert len(finding) < 1000
    return seconds


def same(text: bytes, original: bytes) -> bool:
    """Whether a mutation left the document unchanged, such as a swap of equal values."""
    try:
        return text.count(b":") == original.count(b":") and bool(json.loads(text) == json.loads(original))
    except (ValueError, RecursionError):
        return False


def test_mutated_entries_are_refused(tmp_path: Path, entries: list[Entry]) -> None:
    rng = random.Random(7)
    data = entry_text(entries[0])
    paths = [path for path in places(json.loads(data)) if path]
    # Only what the id covers; the rest is checked only for its form.
    paths = [path for path in paths if path[0] not in ("verification", "provenance", "cost")]
    file = tmp_path / "entry.json"
    seconds: list[float] = []
    while len(seconds) < ENTRIES:
        text = mutated(data, paths, rng)
        if not same(text, data):
            file.write_bytes(text)
            seconds.append(refused(file))
    assert max(seconds) < SECONDS
    assert list(tmp_path.iterdir()) == [file]


def test_mutated_bundles_are_refused(
    tmp_path: Path, entries: list[Entry], files: Mapping[str, bytes]
) -> None:
    """Entries with matching ids, manifests, rows, cards and weights; half with matching checksums."""
    rng = random.Random(8)
    bundle = tmp_path / "bundle.zip"
    seconds: list[float] = []
    names = [name for name in files if name != "LICENSE"]
    while len(seconds) < BUNDLES:
        name = rng.choice(names)
        text = _mutated_file(name, files[name], rng)
        if text == files[name] or same(text, files[name]) or _same_card(text, files[name]):
            continue
        changed = {**files, name: text}
        if name != MANIFEST and rng.random() < 0.5:
            changed = with_manifest(changed)
        bundle.unlink(missing_ok=True)
        write_bundle(bundle, changed)
        seconds.append(refused(bundle))
    assert max(seconds) < SECONDS
    assert list(tmp_path.iterdir()) == [bundle]


def _same_card(text: bytes, original: bytes) -> bool:
    """Whether both are cards and say the same: a field that is left out has its default."""
    try:
        return PolicyCard.model_validate_json(text) == PolicyCard.model_validate_json(original)
    except ValueError:
        return False


def _mutated_file(name: str, data: bytes, rng: random.Random) -> bytes:
    if name.startswith("entries/"):
        # With a matching id: numbers that others are derived from, or that are derived from others.
        own = ("protocol",), ("results", 0, "episodes"), ("results", 0, "metrics")
        numbers = [
            path
            for path in places(json.loads(data))
            if any(path[: len(each)] == each != path for each in own) and "budget" not in str(path[3:4])
        ]
        return mutated(data, numbers, rng, fit_id=True)
    if name == MANIFEST:
        return mutated(data, [path for path in places(json.loads(data)) if path[:1] == ("files",)], rng)
    if name.endswith("policy.json"):
        said = "training", "performance", "family", "initial_seed"  # the submitter of the training
        return mutated(data, [path for path in places(json.loads(data)) if path and path[0] not in said], rng)
    k = rng.randrange(len(data))  # rows and weights: a byte
    return data[:k] + bytes([data[k] ^ (1 << rng.randrange(8))]) + data[k + 1 :]
