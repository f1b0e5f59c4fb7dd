"""Snapshots of a policy and of a process's global state, to detect what an explainer changed."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor, nn

from xmarl_bench.policy import Policy


def traces_of(policy: Policy, observations: Tensor) -> dict[str, str]:
    """Hashes of everything that an explainer could change in a policy, by what it is."""
    with torch.no_grad():
        answer = policy.distribution(observations)
    state = policy.state_dict()
    modules = dict(policy.named_modules())
    return {
        "weights": _hash(state[key] for key in sorted(state)),
        "gradients": str([None if p.grad is None else "set" for p in policy.parameters()]),
        "requires_grad": str([p.requires_grad for p in policy.parameters()]),
        "training mode": str([module.training for module in modules.values()]),
        "hooks": str([_hooks(module) for module in modules.values()]),
        "attributes": str([sorted(vars(module)) for module in modules.values()]),
        "layers": str([(name, type(module).__name__) for name, module in modules.items()]),
        "answers": _hash(part for part in answer if isinstance(part, Tensor)),
    }


def random_states() -> dict[str, str]:
    """The global random states of all libraries used here."""
    return {
        "torch": str(torch.get_rng_state().tolist()),
        "numpy": str(np.random.get_state()),  # noqa: NPY002
        "Python": str(random.getstate()),
    }


def global_settings() -> dict[str, object]:
    """torch's settings for the whole process."""
    return {
        "torch's number of threads": torch.get_num_threads(),
        "torch's default dtype": torch.get_default_dtype(),
        "torch's deterministic mode": torch.are_deterministic_algorithms_enabled(),
        "torch's gradient mode": torch.is_grad_enabled(),
    }


def _hooks(module: nn.Module) -> dict[str, int]:
    """Number of hooks of each kind, including those of PyG's layers."""
    return {
        name: len(hooks)
        for name, hooks in vars(module).items()
        if name.endswith("_hooks") and hasattr(hooks, "__len__")
    }


def _hash(tensors: Iterable[Tensor]) -> str:
    return hashlib.sha256(b"".join(each.detach().cpu().numpy().tobytes() for each in tensors)).hexdigest()
