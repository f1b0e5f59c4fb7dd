"""Cells of CSV files."""

from __future__ import annotations

import pytest

from xmarl_bench.records.csv_cells import csv_cell


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        ("=HYPERLINK(1)", "'=HYPERLINK(1)"),
        ("@SUM(1)", "'@SUM(1)"),
        ("-1+2", "'-1+2"),
        ("\t=1", "'\\t=1"),
        ("a\x1b[31mb\nc", "a\\x1b[31mb\\nc"),
        ("A. Müller", "A. Müller"),
        (-1.5, -1.5),
        (None, None),
    ],
)
def test_a_text_is_never_a_formula_and_numbers_stay(value: object, cell: object) -> None:
    assert csv_cell(value) == cell
