"""A folder keeps once what entries of a policy share, and no file of it can be exchanged unnoticed."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from tests.helpers.made_entries import made_entry
from xmarl_bench.entry.file import (
    entry_text,
    parse_entry,
    read_entries,
    read_entry,
    remove_unused,
    write_entry,
)
from xmarl_bench.entry.schema import Entry
from xmarl_bench.entry.shared import joined, split
from xmarl_bench.errors import InputError
from xmarl_bench.records.files import canonical_json


@pytest.fixture
def entries() -> list[Entry]:
    return [made_entry("policy", name, level, episodes=4) for name, level in (("a", 0.3), ("b", 0.6))]


@pytest.fixture
def files(tmp_path: Path, entries: list[Entry]) -> list[Path]:
    return [write_entry(tmp_path, entry) for entry in entries]


def parts(folder: Path) -> list[Path]:
    return sorted((folder / "shared").iterdir())


def test_parts_are_disjoint_and_join_to_the_entry(entries: list[Entry]) -> None:
    whole = entries[0].model_dump(mode="json")
    own, shared = split(whole)
    assert joined(own, shared) == joined(shared, own) == whole
    (cell,), (of_all,) = own["results"], shared["results"]
    assert list(cell["controls"]) == ["inverted"]
    assert set(of_all["metrics"]) >= {"reward", "attention_entropy", "success_gain"}
    assert "gef" in cell["episodes"]
    assert "gef" not in of_all["episodes"]
    assert set(of_all["episodes"]["budget"]) == {"random", "oracle"}
    assert "protocol" not in own


def test_entries_of_a_policy_share_a_file(files: list[Path], entries: list[Entry], tmp_path: Path) -> None:
    (part,) = parts(tmp_path)
    assert part.stem == hashlib.sha256(part.read_bytes()).hexdigest()
    assert [entry for _, entry in read_entries(tmp_path)] == entries
    assert sum(len(path.read_bytes()) for path in files) < sum(len(entry_text(each)) for each in entries) / 2
    write_entry(tmp_path, made_entry("other", "a", 0.3, episodes=4))
    assert len(parts(tmp_path)) == 2


def test_an_entry_is_the_same_whole_or_in_two_files(files: list[Path], entries: list[Entry]) -> None:
    assert parse_entry(entry_text(entries[0])) == read_entry(files[0]) == entries[0]
    spaced = json.dumps(json.loads(files[0].read_bytes()), indent=1).encode()
    assert parse_entry(spaced, files[0].parent) == entries[0]


def test_a_shared_part_cannot_be_missing_or_changed(files: list[Path], tmp_path: Path) -> None:
    (part,) = parts(tmp_path)
    data = part.read_bytes()
    with pytest.raises(ValueError, match="names a shared part, but a bundle holds whole entries"):
        parse_entry(files[0].read_bytes())
    part.write_bytes(data.replace(b'"policy"', b'"policz"', 1))
    with pytest.raises(InputError, match=r"has the shared part .*, which was changed after it was written"):
        read_entry(files[0])
    part.unlink()
    with pytest.raises(
        InputError, match=f"lacks its shared part shared/{part.name}: copy it beside the entry"
    ):
        read_entry(files[0])


def test_another_shared_part_does_not_fit_the_id(files: list[Path], tmp_path: Path) -> None:
    """With a digest that fits: the policy's reward is better than measured."""
    (part,) = parts(tmp_path)
    shared = json.loads(part.read_bytes())
    shared["results"][0]["episodes"]["reward"][0] = 9.0
    text = canonical_json(shared)
    digest = hashlib.sha256(text).hexdigest()
    (tmp_path / "shared" / f"{digest}.json").write_bytes(text)
    own = json.loads(files[0].read_bytes()) | {"shared": digest}
    files[0].write_bytes(canonical_json(own))
    with pytest.raises(InputError, match="its entry_id does not fit"):
        read_entry(files[0])


@pytest.mark.parametrize("name", ["../../secret", "A" * 64, 3, None])
def test_a_reference_is_a_digest(files: list[Path], name: object) -> None:
    own = json.loads(files[0].read_bytes())
    files[0].write_bytes(canonical_json(own | {"shared": name, "reported": {"shared": "0" * 64}}))
    with pytest.raises(InputError, match="is not an entry"):
        read_entry(files[0])


def test_parts_that_overlap_are_refused() -> None:
    for own, shared in (({"a": 1}, {"a": 1}), ({"a": {}}, {"a": []}), ([{}], [])):
        with pytest.raises(ValueError, match="what its shared part holds too"):
            joined(own, shared)


def test_parts_that_no_entry_names_are_removed(files: list[Path], tmp_path: Path) -> None:
    other = write_entry(tmp_path, made_entry("other", "a", 0.3, episodes=4))
    remove_unused(tmp_path)
    assert len(parts(tmp_path)) == 2
    other.unlink()
    files[1].unlink()
    remove_unused(tmp_path)
    assert len(parts(tmp_path)) == 1
    assert read_entry(files[0]).policy.name == "policy"
