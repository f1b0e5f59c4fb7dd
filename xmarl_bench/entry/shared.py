"""What the entries of a policy share, so that a folder of entries keeps it once.

Shared are policy and protocol, and of each cell its oracle, its controls but the inverted mask, and all
numbers that depend on the policy alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from xmarl_bench.entry.metric_records import EpisodeRow
from xmarl_bench.metrics.table import Group, names_of

Json = dict[str, Any]
Rules = Mapping[str, Any]  # by key: True (shared), False, or the rules of what it holds; "*": all other keys

_OF_POLICY: Rules = dict.fromkeys(names_of(Group.POLICY, Group.GAIN, Group.TASK), True)
_BUDGET: Rules = {"random": True, "oracle": True, "random_error": True}
_CELL: Rules = {
    **dict.fromkeys(("task", "n_agents", "max_cycles", "oracle"), True),
    "metrics": _OF_POLICY,
    "controls": {"*": True, "inverted": False},
    "episodes": {
        **_OF_POLICY,
        **dict.fromkeys(("seed", "length", "timesteps"), True),
        **{name: _BUDGET for name in EpisodeRow.model_fields if name.endswith("budget")},
    },
}
_ENTRY: Rules = {"policy": True, "protocol": True, "results": _CELL}
LEVELS: Final = 5  # of containers in which own and shared parts meet


def split(value: Any, rules: Rules = _ENTRY) -> tuple[Any, Any]:
    """An entry's JSON -> its own part and its shared part."""
    if isinstance(value, list):
        pairs = [split(each, rules) for each in value]
        return [own for own, _ in pairs], [shared for _, shared in pairs]
    own: Json = {}
    shared: Json = {}
    for key, each in value.items():
        rule = rules.get(key, rules.get("*", False))
        if isinstance(rule, Mapping) and isinstance(each, dict | list):
            own[key], shared[key] = split(each, rule)
        else:
            (shared if rule is True else own)[key] = each
    return own, shared


def joined(own: Any, shared: Any, levels: int = LEVELS) -> Any:
    """The JSON of two parts. Raises ValueError, with a clause, if they do not fit."""
    if levels and isinstance(own, dict) and isinstance(shared, dict):
        both = {key: joined(own[key], shared[key], levels - 1) for key in own.keys() & shared.keys()}
        return {**own, **shared, **both}
    if levels and isinstance(own, list) and isinstance(shared, list) and len(own) == len(shared):
        return [joined(one, other, levels - 1) for one, other in zip(own, shared, strict=True)]
    raise ValueError("holds what its shared part holds too")
