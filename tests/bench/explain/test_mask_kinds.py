"""Masks of every kind of tensor: dense floats of 16 bits and more are taken, others refused in a sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from xmarl_bench.errors import InputError
from xmarl_bench.explain.returned_mask import checked_mask

SHAPE = (2, 3, 3)


class Liar(Tensor):
    """Says of itself what the checks want to hear."""

    shape = torch.Size(SHAPE)
    dtype = torch.float32

    @classmethod
    def __torch_function__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func is torch.isfinite:
            return torch.ones(SHAPE, dtype=torch.bool)
        if func in (Tensor.min, Tensor.max):
            return torch.tensor(0.5)
        return super().__torch_function__(func, types, args, kwargs or {})  # type: ignore[no-untyped-call]


def jagged(mask: Tensor) -> Tensor:
    return torch.nested.nested_tensor(list(mask), layout=torch.jagged)


REFUSED: dict[str, tuple[Callable[[Tensor], Tensor], str]] = {
    "sparse": (Tensor.to_sparse, "a sparse tensor"),
    "sparse rows": (Tensor.to_sparse_csr, "a sparse tensor"),
    "meta": (lambda mask: mask.to("meta"), "a meta tensor"),
    "nested": (lambda mask: torch.nested.nested_tensor(list(mask)), "a nested tensor"),
    "jagged": (jagged, "a NestedTensor, which is not a plain tensor"),
    "quantised": (lambda mask: torch.quantize_per_tensor(mask, 0.1, 0, torch.quint8), "a quantised tensor"),
    "float8 e4m3": (lambda mask: mask.to(torch.float8_e4m3fn), "torch.float8_e4m3fn"),
    "float8 e5m2": (lambda mask: mask.to(torch.float8_e5m2), "torch.float8_e5m2"),
    "complex": (lambda mask: mask.to(torch.complex64), "torch.complex64"),
    "bool": (lambda mask: mask > 0, "torch.bool"),
    "NaN of a liar": (lambda mask: (mask * torch.nan).as_subclass(Liar), "NaN or infinity in 18 of 18"),
    "just above one": (lambda mask: mask * 0 + 1 + 2**-20, "mask values from 1.00000095.* to 1.00000095"),
    "range of a liar": (lambda mask: (mask + 7).as_subclass(Liar), "mask values from 7.5 to 7.5"),
    "shape of a liar": (lambda mask: mask[:, :2].as_subclass(Liar), r"a mask of shape \(2, 2, 3\)"),
    "dtype of a liar": (lambda mask: mask.int().as_subclass(Liar), "a mask of torch.int32"),
}


@pytest.mark.filterwarnings("ignore")  # torch warns that some kinds are prototypes
@pytest.mark.parametrize("kind", REFUSED)
def test_a_mask_that_is_not_dense_floats_is_refused_in_a_sentence(kind: str) -> None:
    make, said = REFUSED[kind]
    with pytest.raises(InputError, match=f"^explainer 'mine' returned .*{said}") as raised:
        checked_mask("mine", make(torch.full(SHAPE, 0.5)), 2, 3)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("make", [nn.Parameter, Tensor.half, Tensor.bfloat16, Tensor.double,
                                  lambda mask: mask.as_subclass(Liar)])  # fmt: skip
def test_dense_floats_become_a_plain_tensor_of_the_same_values(make: Callable[[Tensor], Tensor]) -> None:
    mask = torch.linspace(0, 1, 17).repeat(2)[: 2 * 9].reshape(SHAPE)  # 16ths: exact in 16 bits
    checked = checked_mask("mine", make(mask), 2, 3)
    assert type(checked) is Tensor
    assert checked.dtype == torch.float32
    assert not checked.requires_grad
    assert torch.equal(checked, mask)
