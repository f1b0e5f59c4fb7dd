"""Loads objects by reference, `path/to/file.py:Name` or `module:Name`, and records where they came from."""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import inspect
import sys
import textwrap
import tokenize
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import Any

from cloudpickle import register_pickle_by_value

from xmarl_bench.errors import InputError, failures_named
from xmarl_bench.origin.installed import distribution_of, is_own, package_version, places_of


@dataclass(frozen=True)
class Origin:
    """Where code came from, as an entry records it. Holds no path of this machine."""

    distribution: str | None  # None: not from an installed package
    version: str | None
    entry_point: str  # "module:Name" or "file.py:Name"
    # Hash of the file or of the object's source; None for an installed package.
    code_sha256: str | None = None


def is_reference(name: str) -> bool:
    """Whether `name` is a reference to code: registered names hold no colon."""
    return ":" in name


def check_named(name: str) -> None:
    """Raise InputError for a Python file without the name of an object in it. Does not run the file."""
    if not name.endswith(".py"):
        return
    try:
        body = ast.parse(Path(name).read_bytes()).body
    except OSError as error:
        raise InputError(f"{name} cannot be read ({error.strerror}): give path/to/file.py:NAME.") from None
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{name} is not Python ({error}): give path/to/file.py:NAME.") from None
    public = [found for found in definitions(body) if not found.startswith("_")]
    raise InputError(
        f"{name} is a file of code: give {name}:NAME with one of its names: {', '.join(public) or 'none'}."
    )


def definitions(body: Iterable[ast.stmt]) -> dict[str, ast.AST]:
    """The names that statements define, with the function, the class or the value (in part) of each."""
    found: dict[str, ast.AST] = {}
    for each in body:
        if isinstance(each, ast.FunctionDef | ast.ClassDef):
            found[each.name] = each
        elif isinstance(each, ast.Assign | ast.AnnAssign):
            targets = each.targets if isinstance(each, ast.Assign) else [each.target]
            for part in chain.from_iterable(map(ast.walk, targets)):
                if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
                    found[part.id] = each.value or each
    return found


def check_reference(reference: str) -> None:
    """Raise InputError if it has no such form, or if its file cannot be read. Runs nothing."""
    place, _, name = reference.rpartition(":")
    if not place or not all(part.isidentifier() for part in name.split(".")):
        raise InputError(
            f"{reference!r} is not a reference to an object: give path/to/file.py:Name or module:Name."
        )
    if is_file(place):
        _source(Path(place))


def load_reference(reference: str) -> tuple[Any, Origin]:
    """The object and its origin. Runs the code of the file or module.

    A module must be importable: the working directory is not searched. Raises InputError if the file, module
    or name does not exist, or if importing it fails.
    """
    check_reference(reference)
    place, _, name = reference.rpartition(":")
    file = Path(place) if is_file(place) else None
    origin = None if file is None else origin_of_file(file, name)  # before its code runs
    if file is not None:
        module = _import_file(file, reference)
    else:
        with _loading(reference):
            module = importlib.import_module(place)
    found: Any = module
    for part in name.split("."):
        if not hasattr(found, part):
            names = ", ".join(_public(module))
            others = (
                f"give one of {names}" if names else "it defines no names, so give another file or module"
            )
            raise InputError(f"{place} has no {name!r}: {others}.")
        found = getattr(found, part)
    if origin is not None:
        return found, origin
    distribution = distribution_of(place)
    version = None if distribution is None else package_version(distribution)
    return found, Origin(distribution, version, f"{place}:{name}", None if distribution else _of_file(module))


def origin_of(found: object) -> Origin:
    """The origin of an object in memory: its installed package, or the hash of its own source.

    That of a partial is that of its function. The hash covers the source of the function or class, if Python
    finds it, and nothing that it calls.
    """
    if isinstance(found, partial):
        return origin_of(found.func)
    code = found if inspect.isroutine(found) or inspect.isclass(found) else type(found)
    module = code.__module__ or "__main__"  # none if it was made by exec
    where = f"{module}:{code.__qualname__}"
    distribution = distribution_of(module)
    if distribution is not None:
        return Origin(distribution, package_version(distribution), where, None)
    try:
        source = textwrap.dedent(inspect.getsource(code)).encode()
    except (OSError, TypeError, SyntaxError, tokenize.TokenError):  # none, or it has changed
        source = None
    return Origin(None, None, where, None if source is None else hashlib.sha256(source).hexdigest())


def origin_of_file(path: Path, name: str) -> Origin:
    """The origin of an object in a file, which does not run. Raises InputError if it cannot be read."""
    return Origin(None, None, f"{path.name}:{name}", hashlib.sha256(_source(path)).hexdigest())


def is_file(place: str) -> bool:
    """Whether the first part of a reference names a file, and not a module."""
    return place.endswith(".py") or len(Path(place).parts) > 1


def located(reference: str) -> tuple[str, tuple[Path, ...], Origin | None]:
    """A reference with the whole path of its file, the files to read, and its origin; nothing runs.

    A reference to a module stays as it is, and its origin is not known yet. Raises InputError if the file
    cannot be read.
    """
    place, _, name = reference.rpartition(":")
    if not is_file(place):
        return reference, (), None
    path = Path(place).resolve()
    return f"{path}:{name}", (path,), origin_of_file(path, name)


def _source(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give path/to/file.py:Name.") from None


def _import_file(path: Path, reference: str) -> ModuleType:
    """Import a file as a module whose name includes the hash of its content.

    It can import modules beside it, as a script can. All of them are read anew each time. Other processes
    cannot import it by this name, so whoever pickles what it defines sends its code along.
    """
    name = f"{path.stem}_{hashlib.sha256(_source(path)).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path} is not a Python file: give path/to/file.py:Name.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look up their module there
    try:
        with _loading(reference), _neighbours(path.parent.resolve()):
            spec.loader.exec_module(module)
    except InputError:
        del sys.modules[name]
        raise
    register_pickle_by_value(module)
    return module


@contextmanager
def _neighbours(folder: Path) -> Iterator[None]:
    """Make modules of a folder importable, then unload them: another folder may hold the same names."""
    importlib.invalidate_caches()
    before, compiles = set(sys.modules), sys.dont_write_bytecode
    sys.path.insert(0, str(folder))
    sys.dont_write_bytecode = True  # a compiled file hides an edit of the same size within the same second
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        sys.dont_write_bytecode = compiles
        new = [name for name in set(sys.modules) - before if is_own(name)]
        for name in [each for each in new if any(place.is_relative_to(folder) for place in places_of(each))]:
            del sys.modules[name]


def _loading(reference: str) -> AbstractContextManager[None]:
    remedy = "correct it, or give another path/to/file.py:Name or module:Name"
    return failures_named(f"{reference} failed to load", remedy)


def _of_file(module: ModuleType) -> str | None:
    path = getattr(module, "__file__", None)
    return None if path is None else hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _public(module: ModuleType) -> list[str]:
    """Public names that the module itself defines, for an error message."""
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and not isinstance(value, ModuleType)
        and getattr(value, "__module__", None) == module.__name__
    ]
