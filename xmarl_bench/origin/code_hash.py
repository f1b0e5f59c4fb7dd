"""The hash of an object and of its code, for code that no version number identifies.

Code of an installed distribution counts by name and version. The user's own code (a script, a notebook, a
module beside it, an editable install) counts twice: as sources on disk, with the modules beside it, and as it
is in memory, down to globals, closures, defaults, attributes and tensors. Two processes get the same hash for
the same object. Objects that cannot be pickled have no hash.
"""

from __future__ import annotations

import dis
import functools
import hashlib
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import (
    CodeType,
    FunctionType,
    GetSetDescriptorType,
    MemberDescriptorType,
    ModuleType,
    SimpleNamespace,
)
from typing import Any

import cloudpickle
from torch import Tensor

from xmarl_bench.origin.installed import HARNESS, distribution_of, is_own, package_version
from xmarl_bench.origin.pickling import is_generated

LOOKS_UP = ("LOAD_GLOBAL", "LOAD_NAME")
# What a layer of torch_geometric keeps of its class's source; the first layer of a class keeps more.
READ_FROM_CLASS = ("torch_geometric.inspector", "Inspector")
_CACHED = type(functools.cache(len))
NO_CONTENT = ("__dict__", "__weakref__", "__slotnames__", "_abc_impl")  # attributes of every class


def sources_sha256(files: Iterable[tuple[str, Path]]) -> str:
    """Hash of files, each with a name that is the same on every machine."""
    lines = sorted(f"{name} {hashlib.sha256(path.read_bytes()).hexdigest()}" for name, path in files)
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def harness_sources() -> Iterator[tuple[str, Path]]:
    """Every module of the harness."""
    for package in HARNESS:
        folder = Path(str(sys.modules[package].__file__)).parent
        yield from ((f"{package}/{path.relative_to(folder)}", path) for path in folder.rglob("*.py"))


def object_sha256(thing: object) -> str | None:
    """The hash; None if the object cannot be pickled or its sources cannot be read.

    It changes with the version of an installed library whose objects the thing refers to. What a function
    imports when it is called, and what these libraries need, is not seen.
    """
    digest = hashlib.sha256()
    pickler = _ByValue(SimpleNamespace(write=digest.update))
    try:
        pickler.dump(thing)
        sources = sources_sha256(_sources_of(pickler.files))
    except Exception:  # __reduce__ of the user's classes may raise anything
        return None
    known = sorted({each for module in pickler.installed if (each := distribution_of(module)) is not None})
    parts = digest.hexdigest(), sources, *(f"{each} {package_version(each)}" for each in known)
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _sources_of(files: Iterable[Path]) -> Iterator[tuple[str, Path]]:
    """All modules of the packages of these files, or the modules in their folder if they are in no package.

    Not only the modules in memory, because a function may import others when it is called.
    """
    for folder, pattern in {_package_of(file) for file in files if file.is_file()}:
        yield from ((f"{folder.name}/{path.relative_to(folder)}", path) for path in folder.glob(pattern))


def _package_of(file: Path) -> tuple[Path, str]:
    top = file.parent
    while (top.parent / "__init__.py").exists():
        top = top.parent
    return top, "**/*.py" if (top / "__init__.py").exists() else "*.py"


class _ByValue(cloudpickle.Pickler):  # type: ignore[misc]
    """Pickles the user's own code by value, without the random ids and memory addresses of cloudpickle."""

    def __init__(self, file: SimpleNamespace) -> None:
        super().__init__(file)
        self.files: set[Path] = set()  # files of the user's own code, as they occur
        self.installed: set[str] = set()  # top-level modules of other code

    def persistent_id(self, obj: object) -> object:
        """What stands for strings and sets of strings, of which pickle keeps more than the content.

        A string is written each time it occurs, because whether equal ones are one object depends on what ran
        before; the order of a set differs between processes.
        """
        if isinstance(obj, str):  # encoded, a new object: pickle does not refer to an earlier one
            return obj.encode(errors="surrogatepass")
        texts = isinstance(obj, set | frozenset) and all(isinstance(each, str) for each in obj)
        return (type(obj).__name__, sorted(obj)) if texts else None  # type: ignore[call-overload]

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Tensor):
            return _as("tensor", _content_of_tensor(obj))
        if isinstance(obj, CodeType):
            return _as("code", _content_of_code(obj))
        if (type(obj).__module__, type(obj).__name__) == READ_FROM_CLASS:
            return _as("inspector", None)
        name = obj.__name__ if isinstance(obj, ModuleType) else getattr(obj, "__module__", None)
        generated = isinstance(name, str) and is_generated(name)
        own = generated or (isinstance(name, str) and is_own(name))
        if isinstance(name, str) and not own:
            self.installed.add(name.partition(".")[0])
        if own and isinstance(obj, ModuleType):
            self.files.add(Path(obj.__file__ or ""))
            return _as(obj.__name__, {key: each for key, each in vars(obj).items() if key[:2] != "__"})
        if isinstance(obj, FunctionType) and (own or not _has_its_name(obj)):
            if own and not generated:
                self.files.add(Path(obj.__code__.co_filename))
            return _as(obj.__qualname__, _content_of_function(obj))
        if isinstance(obj, type) and (own or not _has_its_name(obj)):
            return _as(obj.__qualname__, _content_of_class(obj))
        if own and isinstance(obj, _CACHED):
            return _as("wrapped", obj.__wrapped__)
        return super().reducer_override(obj)


def _as(name: str, content: object) -> tuple[Any, ...]:
    """A reduce value for an object, whose content may hold the object itself."""
    return _never_loaded, (name,), content


def _has_its_name(obj: FunctionType | type) -> bool:
    """Whether its qualified name leads to it: not for lambdas and for what a function made."""
    if obj.__module__ == "builtins":  # some of its types are not reachable by name
        return True
    found: object = sys.modules.get(obj.__module__)
    for part in obj.__qualname__.split("."):
        found = getattr(found, part, None)
    return found is obj


def _never_loaded(name: str) -> None:
    raise NotImplementedError(name)


def _content_of_tensor(tensor: Tensor) -> object:
    data = tensor.detach().cpu().contiguous()
    return type(tensor), str(tensor.dtype), tuple(tensor.shape), tensor.requires_grad, data.numpy().tobytes()


def _content_of_code(code: CodeType) -> object:
    """Everything but the file name, which differs between processes of a notebook."""
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    arguments = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount
    return code.co_code, code.co_consts, names, arguments, code.co_flags, code.co_exceptiontable


def _content_of_function(function: FunctionType) -> object:
    names = sorted(_names(function.__code__) & function.__globals__.keys())
    return (
        function.__code__, function.__defaults__, function.__kwdefaults__, function.__closure__,
        vars(function), [(name, function.__globals__[name]) for name in names],
    )  # fmt: skip


def _names(code: CodeType) -> set[str]:
    """The globals that code looks up, including functions inside it."""
    inside = (each for each in code.co_consts if isinstance(each, CodeType))
    looked_up = {each.argval for each in dis.get_instructions(code) if each.opname in LOOKS_UP}
    return looked_up.union(*map(_names, inside))


def _content_of_class(cls: type) -> object:
    kept = {
        key: value
        for key, value in vars(cls).items()
        if key not in NO_CONTENT and not isinstance(value, GetSetDescriptorType | MemberDescriptorType)
    }
    return type(cls), cls.__bases__, kept
