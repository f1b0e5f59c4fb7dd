"""Rows of records become columns in JSON and come back the same."""

from __future__ import annotations

import json
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from xmarl_bench.records.columns import ByColumn

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True)
Share = Annotated[float, Field(ge=0, le=1)]


class Curve(BaseModel):
    model_config = STRICT
    x: tuple[float | None, ...]
    error: tuple[float, ...] | None = None


class Row(BaseModel):
    model_config = STRICT
    k: int
    share: Share | None
    added: Share | None = None
    curve: Curve | None = None


class Table(BaseModel):
    model_config = STRICT
    rows: Annotated[tuple[Row, ...], ByColumn(Row)]


shares = st.none() | st.floats(0, 1)
numbers = st.floats(-10, 10)
curves = st.builds(
    Curve, x=st.lists(st.none() | numbers).map(tuple), error=st.none() | st.lists(numbers).map(tuple)
)
rows = st.builds(Row, k=st.integers(), share=shares, added=shares, curve=st.none() | curves)
tables = st.builds(Table, rows=st.lists(rows, max_size=4).map(tuple))


def test_columns_by_hand() -> None:
    table = Table(
        rows=(
            Row(k=1, share=None),
            Row(k=2, share=None, added=0.5, curve=Curve(x=(1.0, None))),
            Row(k=3, share=None),
        )
    )
    columns = {
        "k": [1, 2, 3],
        "share": None,
        "added": [None, 0.5, None],
        "curve": {"x": [None, [1.0, None], None]},
    }
    assert table.model_dump(mode="json") == {"rows": columns}
    assert table.model_dump()["rows"][1] == {
        "k": 2,
        "share": None,
        "added": 0.5,
        "curve": {"x": (1.0, None), "error": None},
    }


@given(tables)
def test_a_table_comes_back_the_same(table: Table) -> None:
    text = table.model_dump_json()
    assert json.loads(text) == table.model_dump(mode="json")
    assert Table.model_validate_json(text) == table
    assert Table(rows=table.rows) == table


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"k": [1, 2], "share": [0.5]}, "the column share has 1 values, others have 2"),
        (
            {"k": [1], "share": None, "curve": {"x": [[1.0], [2.0]]}},
            "the column x has 2 values, others have 1",
        ),
        ({"k": [1, 2], "share": [0.5, 1.5]}, r"rows.share.1"),
        ({"k": [1], "share": [0.5], "curve": {"x": [["a"]]}}, r"rows.curve.x.0.0"),
        ({"k": [1]}, r"rows.share"),
        ({"share": [0.5]}, r"rows.k"),
        ({"k": [1], "share": None, "other": [1]}, r"rows.other"),
        ({"k": None, "share": None}, r"rows.k"),
        ([{"k": 1, "share": None}], r"rows"),
    ],
)
def test_what_are_no_columns_is_refused(columns: object, said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Table.model_validate_json(json.dumps({"rows": columns}))


def test_the_schema_is_that_of_columns() -> None:
    schema = Table.model_json_schema()
    share = schema["$defs"]["RowColumns"]["properties"]["share"]
    assert share["anyOf"][0]["items"]["anyOf"][0] == {"maximum": 1, "minimum": 0, "type": "number"}
    assert schema["$defs"]["RowColumns"]["required"] == ["k", "share"]
