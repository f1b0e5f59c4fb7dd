"""Names of policies and explainers are file names on every system; files get the umask's permissions."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from pydantic import TypeAdapter, ValidationError

from xmarl_bench.records.field_types import Name, is_file_name
from xmarl_bench.records.files import write_atomically


@pytest.mark.parametrize(
    "name", ["a", "gradient-messages", "residual-lambda0.1-seed0", "console", "com", "lpt10", "x.con"]
)
def test_names(name: str) -> None:
    assert is_file_name(name)
    assert TypeAdapter[str](Name).validate_python(name) == name


@pytest.mark.parametrize(
    "name",
    ["", "A", "-a", "a b", "a/b", "a:b", "ä", "a" * 101, "con", "nul.v2", "com1", "lpt9.x.y", "ends-with."],
)
def test_what_cannot_be_a_file_name(name: str) -> None:
    assert not is_file_name(name)
    with pytest.raises(ValidationError):
        TypeAdapter[str](Name).validate_python(name)


@pytest.mark.skipif(os.name != "posix", reason="Windows has no umask")
@pytest.mark.parametrize("umask", [0o022, 0o027, 0o002])
def test_files_have_the_permissions_of_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "folder" / "a.json", b"{}")
    finally:
        os.umask(before)
    assert (tmp_path / "folder" / "a.json").stat().st_mode & 0o777 == 0o666 & ~umask


def test_a_long_name_is_written_too(tmp_path: Path) -> None:
    path = tmp_path / ("a" * 250 + ".json")
    write_atomically(path, b"{}")
    assert [each.name for each in tmp_path.iterdir()] == [path.name]
