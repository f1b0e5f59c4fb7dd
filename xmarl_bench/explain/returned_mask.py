"""Checks what an explainer returned: a dense tensor of the right shape, with finite numbers in [0, 1].

Nothing is clipped, filled or reshaped. Errors name the explainer.
"""

from __future__ import annotations

from contextlib import suppress

import torch
from torch import Tensor

from xmarl_bench.errors import InputError, a_type

FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


def checked_mask(name: str, mask: object, n_steps: int, n_agents: int) -> Tensor:
    """The mask as a detached float32 tensor (S, N, N). Raises InputError if it is not such a mask."""
    numbers = finite(name, as_floats(name, mask, (n_steps, n_agents, n_agents)))
    low, high = float(numbers.min()), float(numbers.max())
    if low < 0.0 or high > 1.0:
        raise InputError(
            f"explainer {name!r} returned mask values from {low} to {high}: scale them to [0, 1]."
        )
    return numbers.to(dtype=torch.float32, copy=True)


def as_floats(name: str, mask: object, expected: tuple[int, ...]) -> Tensor:
    """The mask, detached. Raises InputError unless it is a floating-point tensor of the expected shape."""
    if not isinstance(mask, Tensor):
        raise InputError(
            f"explainer {name!r} returned {a_type(mask)}: return a torch.Tensor of shape {expected}."
        )
    mask = _plain(name, mask)
    kinds = {"sparse": mask.layout != torch.strided, "nested": mask.is_nested, "meta": mask.is_meta,
             "quantised": mask.is_quantized}  # fmt: skip
    kind = next((kind for kind, is_it in kinds.items() if is_it), None)
    if kind is not None:
        raise InputError(f"explainer {name!r} returned a {kind} tensor: return a dense one with its values.")
    if tuple(mask.shape) != expected:
        raise InputError(
            f"explainer {name!r} returned a mask of shape {tuple(mask.shape)}: return shape {expected}."
        )
    if mask.dtype not in FLOATS:
        raise InputError(
            f"explainer {name!r} returned a mask of {mask.dtype}: return floating-point numbers of at least "
            f"16 bits."
        )
    return mask.detach()


def _plain(name: str, mask: Tensor) -> Tensor:
    """The mask as a Tensor of no subclass, because a subclass may answer anything when it is checked."""
    if type(mask) is Tensor:
        return mask
    with suppress(Exception):  # whatever the code of the subclass raises
        plain = Tensor.as_subclass(mask, Tensor)
        if type(plain) is Tensor:
            return plain
    raise InputError(
        f"explainer {name!r} returned {a_type(mask)}, which is not a plain tensor: return a torch.Tensor."
    )


def finite(name: str, mask: Tensor) -> Tensor:
    """The mask. Raises InputError if it holds NaN or infinity."""
    n_bad = int((~torch.isfinite(mask)).sum())
    if n_bad:
        raise InputError(
            f"explainer {name!r} returned NaN or infinity in {n_bad} of {mask.numel()} mask values: "
            f"return finite numbers in [0, 1]."
        )
    return mask
