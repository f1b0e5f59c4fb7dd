"""JSON from third parties: ambiguous, non-finite, too large or too deep values are refused with a reason."""

from __future__ import annotations

import time

import pytest

from xmarl_bench.records.strict_json import MAX_VALUES, parse_json, shown


def test_valid_json_is_parsed() -> None:
    assert parse_json(b'{"a": [1, -2.5e3, true, null, "\\u00e9"], "b": {}}') == {
        "a": [1, -2500.0, True, None, "\u00e9"],
        "b": {},
    }
    assert parse_json(b"[" * 500 + b"]" * 500) != []
    assert parse_json(str(2**53).encode()) == 2**53


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b'{"a": 1, "b": 2, "a": 1}', "has the key 'a' twice in one object"),
        (b'[{"x": {"\\u001b[2J": 1, "\\u001b[2J": 2}}]', r"has the key '\\x1b\[2J' twice"),
        (b"[NaN]", "holds NaN"),
        (b"[-Infinity]", "holds -Infinity"),
        (b"[1e999]", "holds the number '1e999', which is too large"),
        (b"9" * 5000, "holds an integer of 5000 digits"),
        (b"[1,]", "is not JSON"),
        (b"", "is not JSON"),
        (b"\xff\xfe{}", "is not text in UTF-8"),
        (b"[" * 100_000, "nested too deep|is not JSON"),
        (b'{"a":' * 30_000, "nested too deep"),
        (b"[" + b"1," * MAX_VALUES + b"1]", f"holds more values than the limit of {MAX_VALUES}"),
        (b'"' + b"x" * (16 * 2**20) + b'"', "bytes, more than the limit of 16777216"),
    ],
)
def test_invalid_json_is_refused(data: bytes, said: str) -> None:
    started = time.process_time()
    with pytest.raises(ValueError, match=said) as caught:
        parse_json(data)
    assert time.process_time() - started < 1.0
    assert str(caught.value).isprintable()
    assert not str(caught.value).endswith(".")


def test_names_in_errors_are_shown_as_literals() -> None:
    assert shown("two\nlines \x1b[31m\u202e") == "'two\\nlines \\x1b[31m\\u202e'"
    assert shown(3) == "3"
    assert shown(ValueError("no")) == "'no'"
    assert len(shown("x" * 10**6)) <= 80
