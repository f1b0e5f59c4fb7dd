"""Pickles objects for other processes, with the code that a library generates while it runs.

torch_geometric writes the `propagate` of each message-passing class and the `forward` of each Sequential into
modules of their own in the temporary folder. No other process can import these.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import cloudpickle

_looked_at: set[str] = set()  # names of modules


def dumps(thing: object) -> bytes:
    """Pickled by cloudpickle, with the code of modules that only this process can import."""
    for name in sys.modules.keys() - _looked_at:
        _looked_at.add(name)
        if _is_importable_here_alone(name):
            cloudpickle.register_pickle_by_value(sys.modules[name])
    return bytes(cloudpickle.dumps(thing))


def is_generated(module: str) -> bool:
    """Whether a library wrote a loaded module while it ran: its file's name is longer, and random."""
    file = _file_of(sys.modules.get(module))
    return file is not None and file.name.startswith(f"{module}_") and _is_importable_here_alone(module)


def _is_importable_here_alone(name: str) -> bool:
    """Whether a loaded module comes from a Python file that the import system does not find by its name."""
    module = sys.modules.get(name)
    file = _file_of(module)
    if file is None or file.suffix != ".py" or getattr(module, "__name__", None) != name:
        return False
    above, _, last = name.rpartition(".")
    parent = sys.modules.get(above)
    if isinstance(parent, ModuleType) and vars(parent).get(last) is module:  # as the import system leaves it
        return False
    path = getattr(parent, "__path__", ()) if above else None
    return all(finder.find_spec(name, path) is None for finder in sys.meta_path)


def _file_of(module: ModuleType | None) -> Path | None:
    spec = vars(module).get("__spec__") if isinstance(module, ModuleType) else None
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None
