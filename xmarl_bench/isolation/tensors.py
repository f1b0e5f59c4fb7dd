"""Tensors on their way through a pipe. They arrive with the same strides and the same alignment.

torch rounds by both, so that a result in another process has the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import prod
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field, TypeAdapter, ValidationError
from torch import Tensor

VECTOR_BYTES, FLOAT_BYTES = 64, 4  # torch aligns memory to a vector
LOOSE = 2**24  # numbers of memory that a tensor may span besides its own
Stride = Annotated[int, Field(ge=0, strict=True)]
Shift = Annotated[int, Field(ge=0, lt=VECTOR_BYTES // FLOAT_BYTES, strict=True)]
LAYOUT = TypeAdapter(tuple[tuple[Stride, ...], Shift])


@dataclass(frozen=True)
class Sent:
    """A float32 tensor. An axis of stride 0 is sent once."""

    shape: tuple[int, ...]
    stride: tuple[int, ...]
    shift: int  # place of its first number in a vector of memory
    data: bytes

    @classmethod
    def of(cls, tensor: Tensor) -> Sent:
        assert tensor.dtype == torch.float32
        whole = tensor.detach()
        if not _fits(tuple(_once(whole).shape), whole.stride()):
            whole = whole.contiguous()
        data = _once(whole).contiguous().numpy().astype("<f4", copy=False).tobytes()
        shift = whole.data_ptr() % VECTOR_BYTES // FLOAT_BYTES
        return cls(tuple(whole.shape), tuple(whole.stride()), shift, data)

    @classmethod
    def parse(cls, layout: Any, shape: tuple[int, ...], data: bytes) -> Sent:
        """The first tensor of a stranger's answer. Raises ValueError unless it has this shape."""
        try:
            stride, shift = LAYOUT.validate_python(layout)
        except ValidationError:
            raise ValueError("no layout of a tensor") from None
        sent = cls(shape, stride, shift, data)
        n_bytes = FLOAT_BYTES * prod(sent.once)
        if len(stride) != len(shape) or not _fits(sent.once, sent.stride) or len(data) < n_bytes:
            raise ValueError("no tensor of the expected shape")
        return replace(sent, data=data[:n_bytes])

    @property
    def layout(self) -> list[Any]:
        return [list(self.stride), self.shift]

    @property
    def once(self) -> tuple[int, ...]:
        """The shape of what is sent."""
        return tuple(n if step else min(n, 1) for n, step in zip(self.shape, self.stride, strict=False))

    def tensor(self) -> Tensor:
        memory = torch.empty(_span(self.once, self.stride) + self.shift)
        placed = memory[self.shift :].as_strided(self.once, self.stride)
        placed.copy_(torch.from_numpy(np.frombuffer(self.data, dtype="<f4").reshape(self.once).copy()))
        return placed.expand(self.shape)


def _once(tensor: Tensor) -> Tensor:
    """The tensor with one entry on each axis of stride 0."""
    return tensor[tuple(slice(None) if step else slice(0, 1) for step in tensor.stride())]


def _span(shape: tuple[int, ...], stride: tuple[int, ...]) -> int:
    """Numbers from the first to the last."""
    return 0 if 0 in shape else 1 + sum((n - 1) * step for n, step in zip(shape, stride, strict=True))


def _fits(shape: tuple[int, ...], stride: tuple[int, ...]) -> bool:
    """Whether such a tensor spans no more memory than it may, and no number twice."""
    if 0 in shape:
        return True
    reach = 1
    for step, n in sorted(zip(stride, shape, strict=True)):
        if n > 1 and step < reach:
            return False
        reach += (n - 1) * step
    return _span(shape, stride) <= prod(shape) + LOOSE
