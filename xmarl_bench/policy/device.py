"""The device on which torch computes: the CPU, or a GPU for training and for explainers that iterate."""

from __future__ import annotations

import torch

from xmarl_bench.errors import InputError

CPU = "cpu"


def checked_device(name: str) -> str:
    """The name of a device that is there. Raises InputError for one that is unknown or missing."""
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"{name!r} is not a device: choose cpu, cuda, cuda:0 or mps.") from None
    there = {
        "cpu": True,
        "cuda": torch.cuda.is_available() and (device.index or 0) < torch.cuda.device_count(),
        "mps": torch.backends.mps.is_available(),
    }
    if not there.get(device.type, False):
        usable = ", ".join(each for each, found in there.items() if found)
        raise InputError(f"device {name!r} is not available here: choose one of {usable}.")
    return str(device)
