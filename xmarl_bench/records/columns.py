"""Rows by column: JSON of a list of records that repeats no key. What is null in all rows is one null."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from types import NoneType
from typing import Annotated, Any, get_args

from pydantic import BaseModel, GetCoreSchemaHandler, create_model
from pydantic_core import CoreSchema, core_schema

Json = dict[str, Any]


@dataclass(frozen=True)
class ByColumn:
    """Marks a field `tuple[row, ...]` of records: rows in Python, an object of columns in JSON.

    row: its fields are values, or records or None; a column of records is itself an object of columns. At
    least one field is never None. JSON whose columns have different lengths is refused.
    """

    row: type[BaseModel]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        rows, columns = handler(source), handler.generate_schema(columns_model(self.row))
        return core_schema.json_or_python_schema(
            core_schema.no_info_after_validator_function(self._rows, columns),
            rows,
            serialization=core_schema.plain_serializer_function_ser_schema(
                partial(_columns, self.row), when_used="json"
            ),
        )

    def _rows(self, columns: BaseModel) -> tuple[BaseModel | None, ...]:
        n = next(len(column) for _, column in columns if isinstance(column, tuple))
        return tuple(_rows(self.row, columns, n))


def columns_model(row: type[BaseModel], *, gaps: bool = False) -> type[BaseModel]:
    """The record of a row's columns. gaps: rows may be missing, null in all columns."""
    fields: Json = {}
    for name, field in row.model_fields.items():
        record, nullable = _record_in(field.annotation), NoneType in get_args(field.annotation)
        value: Any = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
        value = value | None if gaps else value
        column: Any = tuple[value, ...] if record is None else columns_model(record, gaps=nullable or gaps)
        fields[name] = (column | None if nullable else column, ... if field.is_required() else None)
    return create_model(f"{row.__name__}Columns", __config__=row.model_config, __doc__=row.__doc__, **fields)


def _record_in(annotation: Any) -> type[BaseModel] | None:
    """The record of a field `record` or `record | None`; None for values."""
    for each in get_args(annotation) or (annotation,):
        if isinstance(each, type) and issubclass(each, BaseModel):
            return each
    return None


def _rows(row: type[BaseModel], columns: BaseModel, n: int) -> list[BaseModel | None]:
    """Rows of validated columns; None where all columns are null."""
    values: list[Sequence[Any]] = []
    for name, field in row.model_fields.items():
        column = getattr(columns, name)
        record = _record_in(field.annotation)
        if column is None:
            column = (None,) * n
        elif record is not None:
            column = _rows(record, column, n)
        if len(column) != n:
            raise ValueError(f"the column {name} has {len(column)} values, others have {n}")
        values.append(column)
    names = tuple(row.model_fields)
    return [
        None if all(each is None for each in one) else row.model_validate(dict(zip(names, one, strict=True)))
        for one in zip(*values, strict=True)
    ]


def _columns(row: type[BaseModel], rows: Sequence[BaseModel | None]) -> Json:
    """The columns of rows, without those that are null throughout and may be missing."""
    columns: Json = {}
    for name, field in row.model_fields.items():
        values: Any = [None if each is None else getattr(each, name) for each in rows]
        if rows and all(value is None for value in values):
            if field.is_required():
                columns[name] = None
            continue
        record = _record_in(field.annotation)
        columns[name] = values if record is None else _columns(record, values)
    return columns
