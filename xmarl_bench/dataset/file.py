"""A dataset on disk: `<name>.safetensors`, its card `<name>.md`, and the policy as a bundle beside them.

The file holds arrays and, as its metadata, the card: reading it executes nothing. The arrays are in one
order and without dates, so that the same dataset has the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydantic import ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from xmarl_bench.dataset.card import Card
from xmarl_bench.dataset.tables import Dataset
from xmarl_bench.errors import InputError
from xmarl_bench.policy.bundle import write_bundle
from xmarl_bench.records.files import write_atomically
from xmarl_bench.records.strict_json import first_error, shown

POLICIES = "policies"
CARD = "card"


def write_dataset(folder: Path, dataset: Dataset) -> Path:
    """Write file and card, and the policy into `policies/` unless it is code. Returns the file's path."""
    card, arrays = dataset.card, dataset.arrays
    path = folder / f"{card.name}.safetensors"
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    described = {name: (str(array.dtype), array.shape) for name, array in arrays.items()}
    write_atomically(path, save(arrays, metadata={CARD: card.model_dump_json()}))
    write_atomically(path.with_suffix(".md"), card.page(described).encode())
    if dataset.bundle is not None:
        write_bundle(folder / POLICIES / dataset.bundle[0].name, *dataset.bundle)
    return path


def written(folder: Path, make: Callable[[], Dataset]) -> Path:
    """Make a dataset and write it: the unit of work of `xmarl-bench export`."""
    return write_dataset(folder, make())


def read_dataset(path: Path) -> Dataset:
    """Read a file that `write_dataset` wrote. Raises InputError for another file."""
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        return Dataset(Card.model_validate_json(metadata.get(CARD, "")), arrays)
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path} cannot be read as safetensors ({shown(error)}): export it again.") from None
    except ValidationError as error:
        raise InputError(
            f"{path} holds no card of a dataset ({first_error(error)[0]}): give a file of "
            f"`xmarl-bench export`."
        ) from None
