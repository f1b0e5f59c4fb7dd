"""The file of an entry is canonical JSON in lines; other layouts are read, or refused, alike."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.bench.submission.edits import with_id
from tests.helpers.made_entries import made_entry
from xmarl_bench.entry.file import entry_text, parse_entry
from xmarl_bench.records.files import canonical_json, pretty_json
from xmarl_bench.records.json_lines import json_lines, members, object_of

ENTRY = made_entry("policy", "explainer", 0.5, episodes=4)
plain = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
)
# Deep and wide enough for every kind of line break; most of the time goes into drawing them.
values = st.recursive(
    plain,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(), inner, max_size=5),
    max_leaves=20,
)


@pytest.mark.slow
@given(values, st.integers(0, 4))
def test_joined_lines_are_canonical_json(value: Any, levels: int) -> None:
    assert json_lines(value, levels).replace(b"\n", b"") == canonical_json(value)


@pytest.mark.slow
@given(st.dictionaries(st.text(), values, max_size=5))
def test_the_members_make_up_the_object(value: dict[str, Any]) -> None:
    assert object_of(members(value)) == canonical_json(value)


def test_a_column_and_a_control_have_a_line_each() -> None:
    lines = entry_text(ENTRY).splitlines()
    assert b'"makespan":[50.0,50.0,50.0,50.0],' in lines
    assert b'"no_object_collision":null,' in lines
    assert sum(line.startswith((b'"controls":{"all-ones":', b'"zeros":{')) for line in lines) == 2
    assert len(entry_text(ENTRY)) < 1.02 * len(canonical_json(ENTRY.model_dump(mode="json")))


Write = Callable[[Any], bytes]


def one_line(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


def spaced(value: Any) -> bytes:
    return json.dumps(value, indent=1).encode()


@pytest.mark.parametrize("write", [one_line, spaced, pretty_json, lambda value: json_lines(value, 9)])
def test_any_layout_is_read(write: Write) -> None:
    assert parse_entry(write(ENTRY.model_dump(mode="json"))) == ENTRY


def hyperparameter(value: Any) -> Callable[[dict[str, Any]], object]:
    return lambda entry: entry["explainer"]["hyperparameters"].update(level=value)


@pytest.mark.slow
@pytest.mark.parametrize("write", [one_line, spaced])
@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda v: v["cost"].update(behaviour_seconds=1), "is not in the canonical form"),
        (lambda v: v["explainer"].pop("accesses"), "is not in the canonical form"),
        (hyperparameter(float("nan")), "holds NaN"),
        (hyperparameter(-float("inf")), "holds -Infinity"),
        (lambda v: v.update(reported={"x": float("nan")}), "holds NaN"),
        (hyperparameter(10**20), "holds an integer of 21 digits"),
        (hyperparameter(-(10**19)), "holds an integer of 21 digits"),
        (lambda v: v.update(reported={"x": [1, 10**30]}), "holds an integer of 31 digits"),
        (lambda v: v.update(submitter="x" * 10_001), "at most 10000 characters at submitter"),
    ],
)
def test_invalid_entries_are_refused_in_every_layout(
    write: Write, edit: Callable[[dict[str, Any]], object], said: str
) -> None:
    value = ENTRY.model_dump(mode="json")
    edit(value)
    with_own_id = any(word in said for word in ("NaN", "Infinity", "canonical"))
    text = write(value if with_own_id else with_id(value))
    with pytest.raises(ValueError, match=said):
        parse_entry(text)


def test_a_duplicate_key_is_refused_in_one_line_too() -> None:
    text = entry_text(ENTRY).replace(b'"submitter":null', b'"submitter":null,"submitter":null')
    with pytest.raises(ValueError, match="has the key 'submitter' twice"):
        parse_entry(text)


def test_long_integers_within_the_limit_are_read() -> None:
    for number in (10**20 - 1, -(10**19) + 1):
        value = ENTRY.model_dump(mode="json")
        hyperparameter(number)(value)
        value = with_id(value)
        assert parse_entry(one_line(value)).explainer.hyperparameters == {"level": number}
