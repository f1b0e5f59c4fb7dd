"""Cells of CSV files that no spreadsheet takes for a formula (OWASP, CSV Injection)."""

from __future__ import annotations

FORMULA = ("=", "+", "-", "@", "\t", "\r")


def csv_cell(value: object) -> object:
    """The value; of a text, with control characters escaped and an apostrophe before what begins a formula.

    Numbers stay numbers: a negative one is not a formula.
    """
    if not isinstance(value, str):
        return value
    text = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in value)
    return f"'{text}" if value.startswith(FORMULA) else text
