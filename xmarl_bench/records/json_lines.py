"""Canonical JSON in parts: by member, and in lines, so that a diff shows what changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xmarl_bench.records.files import canonical_json


def json_lines(value: Any, levels: int) -> bytes:
    """The canonical text with a line break after each member of the outermost `levels` of containers.

    Containers that hold no others stay on one line. Without its line breaks it is `canonical_json(value)`.
    """
    if levels == 0 or not isinstance(value, dict | list):
        return canonical_json(value)
    inner = value.values() if isinstance(value, dict) else value
    if not any(isinstance(each, dict | list) for each in inner):
        return canonical_json(value)
    if isinstance(value, dict):
        items = [canonical_json(key) + b":" + json_lines(value[key], levels - 1) for key in sorted(value)]
        return b"{" + b",\n".join(items) + b"}"
    return b"[" + b",\n".join(json_lines(each, levels - 1) for each in value) + b"]"


def members(value: Mapping[str, Any]) -> dict[str, bytes]:
    """The canonical text of each member of an object, by its key."""
    return {key: canonical_json(each) for key, each in value.items()}


def object_of(members: Mapping[str, bytes]) -> bytes:
    """The canonical text of an object with these members."""
    return b"{" + b",".join(canonical_json(key) + b":" + members[key] for key in sorted(members)) + b"}"
