"""Objects named by where their code is, `path/to/file.py:Name` or `module:Name`, and what pins it down."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from cloudpickle import register_pickle_by_value

from xmarl_bench.errors import InputError
from xmarl_bench.origin.installed import distribution_of, is_own, package_version, places_of


@dataclass(frozen=True)
class Origin:
    """Where code came from, as an entry records it. Paths of a machine stay out of it."""

    distribution: str | None  # installed package that holds it
    version: str | None
    entry_point: str  # "module:Name" or "file.py:Name"
    # Of the file, or of an object's own source; None for an installed package.
    code_sha256: str | None = None


def is_reference(name: str) -> bool:
    """Whether `name` says where code is; what an entry point registers holds no colon."""
    return ":" in name


def load_reference(reference: str) -> tuple[Any, Origin]:
    """The object and its origin. This runs the code of the file or module.

    A module must be importable; the folder of the command is not searched. Raises InputError where there is
    no such file, module or name, and where importing it fails, with its error.
    """
    place, _, name = reference.rpartition(":")
    if not place or not all(part.isidentifier() for part in name.split(".")):
        raise InputError(f"{reference!r} names no object: give path/to/file.py:Name or module:Name.")
    is_file = place.endswith(".py") or len(Path(place).parts) > 1
    sha256 = None
    if is_file:
        module, sha256 = _import_file(Path(place), reference)
    else:
        module = _import_module(place, reference)
    found: Any = module
    for part in name.split("."):
        if not hasattr(found, part):
            raise InputError(f"{place} has no {name!r}: give one of {', '.join(_public(module)) or 'none'}.")
        found = getattr(found, part)
    if is_file:
        return found, Origin(None, None, f"{Path(place).name}:{name}", sha256)
    distribution = distribution_of(place)
    version = None if distribution is None else package_version(distribution)
    return found, Origin(distribution, version, f"{place}:{name}", None if distribution else _of_file(module))


def origin_of(found: object) -> Origin:
    """Of an object that was handed over: the installed package it is of, or the hash of its own source.

    The hash covers the source of the function or class, where Python has it, and nothing that it calls.
    """
    code = found if inspect.isroutine(found) or inspect.isclass(found) else type(found)
    where = f"{code.__module__}:{code.__qualname__}"
    distribution = distribution_of(code.__module__)
    if distribution is not None:
        return Origin(distribution, package_version(distribution), where, None)
    try:
        source = textwrap.dedent(inspect.getsource(code)).encode()
    except (OSError, TypeError):
        source = None
    return Origin(None, None, where, None if source is None else hashlib.sha256(source).hexdigest())


def _import_file(path: Path, reference: str) -> tuple[ModuleType, str]:
    """A module of its own for each content of the file.

    Modules beside it can be imported, as from a script; they too are read anew each time, and sent to worker
    processes by value.
    """
    try:
        source = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give path/to/file.py:Name.") from None
    sha256 = hashlib.sha256(source).hexdigest()
    name = f"{path.stem}_{sha256[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path} is no Python file: give path/to/file.py:Name.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up there
    try:
        with _neighbours(path.parent.resolve()):
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise _failed(reference, error) from error
    register_pickle_by_value(module)
    return module, sha256


@contextmanager
def _neighbours(folder: Path) -> Iterator[None]:
    """Its modules can be imported, and are forgotten afterwards: another folder may name its own alike."""
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


def _import_module(name: str, reference: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except (Exception, SystemExit) as error:
        raise _failed(reference, error) from error


def _failed(reference: str, error: BaseException) -> InputError:
    return InputError(
        f"{reference} failed to load ({type(error).__name__}: {error}): correct it, or give "
        f"path/to/file.py:Name or module:Name of something else."
    )


def _of_file(module: ModuleType) -> str | None:
    path = getattr(module, "__file__", None)
    return None if path is None else hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _public(module: ModuleType) -> list[str]:
    """What the module itself defines, for an error."""
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ]
