"""`xmarl-bench new explainer|policy`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Kind(StrEnum):
    explainer = "explainer"
    policy = "policy"


def new(
    kind: Annotated[Kind, typer.Argument(help="What the package registers.")],
    name: Annotated[str, typer.Argument(help="Its name, such as my-explainer.")],
    out: Annotated[Path | None, typer.Option(help="Folder to write; ./NAME by default.")] = None,
) -> None:
    """Write a small installable package with an entry point and a test that passes."""
    from xmarl_bench.plugins.new_package import write_package

    folder = Path(name) if out is None else out
    for path in write_package(kind.value, name, folder):
        print(path)
    trust = " --trust-code" if kind is Kind.policy else ""
    print(f"Next: pip install --editable {folder} && xmarl-bench check {kind.value} {name}{trust}")
