"""Scores explainers of multi-agent graph-attention policies. The public API is what `__all__` names.

Names are loaded on first use, so that `xmarl-bench --help` does not wait for torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from xmarl_bench.parallel.loading import without_collector

if TYPE_CHECKING:
    from xmarl_bench.board import build_board
    from xmarl_bench.entry.file import read_entry, write_entry
    from xmarl_bench.entry.schema import Entry
    from xmarl_bench.errors import InputError
    from xmarl_bench.explain.adapters import as_explainer
    from xmarl_bench.explain.explainer import Explainer
    from xmarl_bench.explain.messages_only import messages_only
    from xmarl_bench.explain.pyg import PygExplain
    from xmarl_bench.policy import (
        Architecture,
        CompleteGraph,
        FixedGraph,
        GraphLayer,
        GraphPolicy,
        LayeredArchitecture,
        PolicyCard,
        RadiusGraph,
        build_policy,
        load_policy,
        save_policy,
    )
    from xmarl_bench.policy.policy_module import PolicyModule
    from xmarl_bench.rollout.episodes import Episode, roll_out
    from xmarl_bench.rollout.evaluation import Performance, evaluate
    from xmarl_bench.scoring.score import score

_MODULES = {
    "Architecture": "policy",
    "CompleteGraph": "policy",
    "Entry": "entry.schema",
    "Episode": "rollout.episodes",
    "Explainer": "explain.explainer",
    "FixedGraph": "policy",
    "GraphLayer": "policy",
    "GraphPolicy": "policy",
    "InputError": "errors",
    "LayeredArchitecture": "policy",
    "Performance": "rollout.evaluation",
    "PolicyCard": "policy",
    "PolicyModule": "policy.policy_module",
    "PygExplain": "explain.pyg",
    "RadiusGraph": "policy",
    "as_explainer": "explain.adapters",
    "build_board": "board",
    "build_policy": "policy",
    "evaluate": "rollout.evaluation",
    "load_policy": "policy",
    "messages_only": "explain.messages_only",
    "read_entry": "entry.file",
    "roll_out": "rollout.episodes",
    "save_policy": "policy",
    "score": "scoring.score",
    "write_entry": "entry.file",
}

__all__ = [
    "Architecture", "CompleteGraph", "Entry", "Episode", "Explainer", "FixedGraph", "GraphLayer",
    "GraphPolicy", "InputError", "LayeredArchitecture", "Performance", "PolicyCard", "PolicyModule",
    "PygExplain", "RadiusGraph", "as_explainer", "build_board", "build_policy", "evaluate", "load_policy",
    "messages_only", "read_entry", "roll_out", "save_policy", "score", "write_entry",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'xmarl_bench' has no attribute {name!r}")
    with without_collector():
        value = getattr(import_module(f"xmarl_bench.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
