"""`xmarl-bench new explainer|policy`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer


def new(
    kind: Annotated[Literal["explainer", "policy"], typer.Argument(help="What the package registers.")],
    name: Annotated[str, typer.Argument(help="Its name, such as my-explainer.")],
    out: Annotated[Path | None, typer.Option(help="Folder to write; ./NAME by default.")] = None,
) -> None:
    """Write a small installable package with an entry point and a test that passes."""
    from xmarl_bench.plugins.new_package import write_package

    folder = Path(name) if out is None else out
    for path in write_package(kind, name, folder):
        print(path)
    trust = " --trust-code" if kind == "policy" else ""
    print(f"Next: pip install --editable {folder} && xmarl-bench check {kind} {name}{trust}")
