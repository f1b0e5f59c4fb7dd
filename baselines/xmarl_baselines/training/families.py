"""The two families of reference policies, as `Architecture` records (without obs_dim).

`paper`: the architectures of Kailas et al. (ICML 2025, section "Tasks"). `residual`: the same with
GATv2Conv(residual=True), so that an agent's own encoding reaches its decoder beside the messages.
"""

from __future__ import annotations

from typing import Any, Literal

from xmarl_bench.errors import InputError

Family = Literal["paper", "residual"]
FAMILIES: tuple[Family, ...] = ("residual", "paper")  # the first is the default

PAPER: dict[str, dict[str, Any]] = {
    "blind_navigation_v0": {
        "encoder": (), "encoder_activation": "tanh", "gat_width": 32, "gat_activation": "tanh",
        "decoder": (256, 256), "decoder_activation": "tanh",
    },
    "blind_passage_v0": {
        "encoder": (32, 32, 32, 32), "encoder_activation": "relu", "gat_width": 32, "gat_activation": "tanh",
        "decoder": (64, 64, 64, 64), "decoder_activation": "relu",
    },
    "blind_discovery_v0": {
        "encoder": (64,), "encoder_activation": "relu", "gat_width": 64, "gat_activation": "relu",
        "decoder": (64, 64), "decoder_activation": "relu",
    },
}  # fmt: skip


def architecture(task: str, family: Family) -> dict[str, Any]:
    """The record of a family's network for one task. Raises InputError for an unknown task or family."""
    if task not in PAPER:
        raise InputError(f"no reference network for task {task!r}: choose one of {', '.join(PAPER)}.")
    if family not in FAMILIES:
        raise InputError(f"no family is called {family!r}: choose {' or '.join(FAMILIES)}.")
    return {**PAPER[task], "residual": family == "residual"}
