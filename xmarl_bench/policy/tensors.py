"""Which tensors a policy must consist of to be scored."""

from __future__ import annotations

from itertools import chain
from typing import Final

import torch
from torch import nn
from torch.nn.parameter import is_lazy

from xmarl_bench.errors import InputError, a_type

EXTRA_STATE: Final = "_extra_state"  # torch's name in a state dict for what `get_extra_state` returns


def check_tensors(network: nn.Module, name: str) -> None:
    """Raise InputError if a tensor is not dense float32 on the CPU, or cannot take part in gradients.

    Also if the network has a state beside its tensors (`get_extra_state`), which their hash does not cover.
    """
    for key, tensor in chain(network.named_parameters(), network.named_buffers()):
        if is_lazy(tensor):
            problem, remedy = (
                "has no shape yet",
                "run the network once, or give its layers their input widths",
            )
        elif tensor.device.type != "cpu":
            problem, remedy = f"is on {tensor.device}", 'move the network with .to("cpu")'
        elif tensor.layout != torch.strided:
            layout = str(tensor.layout).removeprefix("torch.")
            problem, remedy = f"has layout {layout}", "make it dense with .to_dense()"
        elif tensor.is_floating_point() and tensor.dtype != torch.float32:
            problem, remedy = f"is {str(tensor.dtype).removeprefix('torch.')}", "convert it with .float()"
        elif tensor.is_inference():
            problem, remedy = "was made in torch.inference_mode", "make the network outside of it"
        else:
            continue
        raise InputError(f"tensor {key!r} of policy {name!r} {problem}: {remedy}.")
    for key, value in network.state_dict().items():
        if key.rpartition(".")[2] == EXTRA_STATE:
            raise InputError(
                f"policy {name!r} keeps {a_type(value)} in {key!r} (get_extra_state) beside its "
                f"tensors: register it as a buffer."
            )
