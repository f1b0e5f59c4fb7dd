"""The hash of an object and of the code that it brings along, for what no version pins down.

Code of an installed distribution counts by name: its version stands for it. Own code (a script, a notebook,
a module beside it, an editable install) counts twice: as sources on disk, its neighbours included, and as it
is in memory, down to globals, closures, defaults, attributes and tensors. Two processes get the same hash for
the same object. What cannot be pickled has none.
"""

from __future__ import annotations

import dis
import hashlib
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, GetSetDescriptorType, MemberDescriptorType, ModuleType
from typing import Any

import cloudpickle
from torch import Tensor

from xmarl_bench.origin.installed import HARNESS, is_own

LOOKS_UP = ("LOAD_GLOBAL", "LOAD_NAME")
NO_CONTENT = ("__dict__", "__weakref__", "__slotnames__", "_abc_impl")  # of a class


def sources_sha256(files: Iterable[tuple[str, Path]]) -> str:
    """Of files, each under a name that is the same on every machine."""
    lines = sorted(f"{name} {hashlib.sha256(path.read_bytes()).hexdigest()}" for name, path in files)
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def harness_sources() -> Iterator[tuple[str, Path]]:
    """Every module of the harness."""
    for package in HARNESS:
        folder = Path(str(sys.modules[package].__file__)).parent
        yield from ((f"{package}/{path.relative_to(folder)}", path) for path in folder.rglob("*.py"))


def object_sha256(thing: object) -> str | None:
    """None for what cannot be pickled, or whose sources cannot be read."""
    digest = _Digest()
    try:
        pickler = _ByValue(digest)
        pickler.dump(thing)
        return f"{digest.sha256.hexdigest()}{sources_sha256(_sources_of(pickler.files))}"
    except Exception:  # whatever the __reduce__ of a stranger's class raises
        return None


def _sources_of(files: Iterable[Path]) -> Iterator[tuple[str, Path]]:
    """Every module of the packages that files are of, or else the files of their folder: one that is imported
    when a function is called is not there yet."""
    for folder, pattern in {_package_of(file) for file in files if file.is_file()}:
        yield from ((f"{folder.name}/{path.relative_to(folder)}", path) for path in folder.glob(pattern))


def _package_of(file: Path) -> tuple[Path, str]:
    top = file.parent
    while (top.parent / "__init__.py").exists():
        top = top.parent
    return top, "**/*.py" if (top / "__init__.py").exists() else "*.py"


class _Digest:
    """A file that keeps nothing but the hash of what was written."""

    def __init__(self) -> None:
        self.sha256 = hashlib.sha256()

    def write(self, data: bytes) -> int:
        self.sha256.update(data)
        return len(data)


class _ByValue(cloudpickle.Pickler):  # type: ignore[misc]
    """Writes own code by value. cloudpickle's way to do so draws random ids and names memory addresses."""

    def __init__(self, file: _Digest) -> None:
        super().__init__(file)
        self.files: set[Path] = set()  # of own code, as it was met

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Tensor):
            return _as("tensor", _content_of_tensor(obj))
        if isinstance(obj, CodeType):
            return _as("code", _content_of_code(obj))
        name = obj.__name__ if isinstance(obj, ModuleType) else getattr(obj, "__module__", None)
        own = isinstance(name, str) and is_own(name)
        if own and isinstance(obj, ModuleType):
            self.files.add(Path(obj.__file__ or ""))
            return _as(obj.__name__, {key: each for key, each in vars(obj).items() if key[:2] != "__"})
        if isinstance(obj, FunctionType) and (own or not _has_its_name(obj)):
            if own:
                self.files.add(Path(obj.__code__.co_filename))
            return _as(obj.__qualname__, _content_of_function(obj))
        if isinstance(obj, type) and (own or not _has_its_name(obj)):
            return _as(obj.__qualname__, _content_of_class(obj))
        if own and callable(obj) and hasattr(obj, "__wrapped__"):  # functools.cache
            return _as("wrapped", obj.__wrapped__)
        return super().reducer_override(obj)


def _as(name: str, content: object) -> tuple[Any, ...]:
    """What pickle takes for an object; its content may hold the object itself."""
    return _never_loaded, (name,), content


def _has_its_name(obj: FunctionType | type) -> bool:
    """Whether its name leads to it; not if a function made it, nor if it is a lambda."""
    if obj.__module__ == "builtins":  # some of its types have no name there
        return True
    found: object = sys.modules.get(obj.__module__)
    for part in obj.__qualname__.split("."):
        found = getattr(found, part, None)
    return found is obj


def _in_order(value: object) -> object:
    """Strings in a set are in another order in each process."""
    texts = isinstance(value, set | frozenset) and all(isinstance(each, str) for each in value)
    return (type(value), sorted(value)) if texts else value  # type: ignore[call-overload]


def _never_loaded(name: str) -> None:
    raise NotImplementedError(name)


def _content_of_tensor(tensor: Tensor) -> object:
    data = tensor.detach().cpu().contiguous()
    return type(tensor), str(tensor.dtype), tuple(tensor.shape), tensor.requires_grad, data.numpy().tobytes()


def _content_of_code(code: CodeType) -> object:
    """All but the name of the file, which a notebook makes anew in each process."""
    consts = [_in_order(each) for each in code.co_consts]
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    arguments = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount
    return code.co_code, consts, names, arguments, code.co_flags, code.co_exceptiontable


def _content_of_function(function: FunctionType) -> object:
    names = sorted(_names(function.__code__) & function.__globals__.keys())
    return (
        function.__code__, function.__defaults__, function.__kwdefaults__, function.__closure__,
        vars(function), [(name, _in_order(function.__globals__[name])) for name in names],
    )  # fmt: skip


def _names(code: CodeType) -> set[str]:
    """The globals that code looks up, functions inside it included."""
    inside = (each for each in code.co_consts if isinstance(each, CodeType))
    looked_up = {each.argval for each in dis.get_instructions(code) if each.opname in LOOKS_UP}
    return looked_up.union(*map(_names, inside))


def _content_of_class(cls: type) -> object:
    kept = {
        key: _in_order(value)
        for key, value in vars(cls).items()
        if key not in NO_CONTENT and not isinstance(value, GetSetDescriptorType | MemberDescriptorType)
    }
    return type(cls), cls.__bases__, kept
