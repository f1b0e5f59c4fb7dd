"""Writes a small package that registers a working explainer or policy.

Its files are made from `templates/<kind>/` beside this module; PACKAGE in their names is replaced.
"""

from __future__ import annotations

import keyword
import sys
from importlib.util import find_spec
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from xmarl_bench.errors import InputError
from xmarl_bench.origin.installed import package_version
from xmarl_bench.plugins.names import explainer_names, registered_policies
from xmarl_bench.records.field_types import is_file_name
from xmarl_bench.records.files import check_writable, write_atomically

TEMPLATES = Path(__file__).with_name("templates")


def write_package(kind: str, name: str, folder: Path) -> list[Path]:
    """Write the package `name` into `folder`; returns its files.

    Raises InputError if the name is invalid for Python or the registry or already in use, or if the folder
    is not empty.
    """
    package = name.replace("-", "_").replace(".", "_")
    if not is_file_name(name) or not package.isidentifier() or keyword.iskeyword(package):
        raise InputError(
            f"{name!r} is not a valid package name: start with a letter, then a-z, 0-9, - and _, such as "
            f"my-{kind}."
        )
    taken = explainer_names() if kind == "explainer" else registered_policies()[0]
    if name in taken:
        raise InputError(f"an installed {kind} is named {name!r}: choose another name.")
    if package in sys.stdlib_module_names or find_spec(package) is not None:
        raise InputError(f"a module {package!r} is already installed: choose another name than {name!r}.")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} already exists: choose another folder with --out, or remove it.")
    check_writable(folder)
    environment = Environment(undefined=StrictUndefined, keep_trailing_newline=True)
    context = {"name": name, "package": package, "harness": package_version("xmarl-bench") or "0.1.0"}
    written = []
    for template in sorted((TEMPLATES / kind).rglob("*.jinja")):
        relative = str(template.relative_to(TEMPLATES / kind)).removesuffix(".jinja")
        path = folder / relative.replace("PACKAGE", package)
        text = environment.from_string(template.read_text(encoding="utf-8")).render(context)
        write_atomically(path, text.encode())
        written.append(path)
    return written
