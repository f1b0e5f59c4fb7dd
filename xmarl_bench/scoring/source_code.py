"""The code that a result comes from, as one hash: change a line of it and the result is computed again."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

OURS = ("xmarl_envs", "xmarl_bench")


@cache
def source_sha256(*modules: str) -> str | None:
    """sha256 of the source of modules and of what they import, at first or second hand.

    Followed are imports of our own packages and of the packages that the modules are in; other packages
    count by their version. Comments, docstrings and layout do not count. None where one of the modules has no
    source.
    """
    packages = {*OURS, *(name.split(".")[0] for name in modules)}
    waiting, found = list(modules), dict[str, str]()
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        source = _source(name)
        if source is None:
            if name in modules:
                return None
            continue  # a name inside a module
        tree = ast.parse(source)
        found[name] = hashlib.sha256(ast.dump(_without_texts(tree)).encode()).hexdigest()
        waiting += [each for each in _imported(name, tree) if each.split(".")[0] in packages]
    return hashlib.sha256("\n".join(f"{name} {found[name]}" for name in sorted(found)).encode()).hexdigest()


def _source(module: str) -> bytes | None:
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):
        return None
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    return Path(spec.origin).read_bytes()


def _without_texts(tree: ast.Module) -> ast.Module:
    """The tree, its statements that are nothing but a text taken out."""
    for node in ast.walk(tree):
        for body in ("body", "orelse", "finalbody"):
            statements = getattr(node, body, None)
            if isinstance(statements, list):
                setattr(node, body, [each for each in statements if not _is_text(each)])
    return tree


def _is_text(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def _imported(module: str, tree: ast.Module) -> Iterator[str]:
    """Names that may be modules: of `from a import b` both a and a.b."""
    package = module.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:  # relative: one dot is the module's own package, or itself where it is one
                spec = find_spec(module)
                here = module if spec is not None and spec.submodule_search_locations else package
                base = ".".join([*here.split(".")[: len(here.split(".")) - node.level + 1], *base.split(".")])
                base = base.rstrip(".")
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)
