"""Networks inside the modules that torch wraps around them, and the names of their tensors."""

from __future__ import annotations

from torch import nn
from torch.nn.parallel import DistributedDataParallel
from torch.optim.swa_utils import AveragedModel

COMPILED = "_orig_mod"  # torch.compile's name of the network inside, also in saved state dicts
WRAPPERS = (nn.DataParallel, DistributedDataParallel, AveragedModel)  # their network is `module`


def unwrapped(network: nn.Module) -> nn.Module:
    """The network inside torch.compile, DataParallel, DistributedDataParallel and AveragedModel."""
    children = dict(network.named_children())
    if children.keys() == {COMPILED}:
        return unwrapped(children[COMPILED])
    if isinstance(network, WRAPPERS):
        return unwrapped(children["module"])
    return network


def plain_name(name: str) -> str:
    """A tensor's name without the parts that wrappers add, around the network or around parts of it."""
    return ".".join(part for part in name.split(".") if part not in (COMPILED, "module"))
