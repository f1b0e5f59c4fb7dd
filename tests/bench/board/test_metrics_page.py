"""docs/metrics.md and the protocol's definitions speak of every metric that an entry has, and of no other."""

from __future__ import annotations

import re
from pathlib import Path

from xmarl_bench.entry.protocol import DEFINITIONS
from xmarl_bench.entry.schema import Metrics
from xmarl_bench.explain.controls import CONTROLS, INVERTED

PAGE = (Path(__file__).parents[3] / "docs" / "metrics.md").read_text(encoding="utf-8")
TASK_METRICS = {"reward", "success_rate", "no_agent_collision", "no_object_collision", "makespan"}


def test_every_metric_is_defined_in_the_protocol() -> None:
    for name in Metrics.model_fields:
        assert name in DEFINITIONS or f"{name.split('_')[0]}_*" in DEFINITIONS, name


def test_the_page_explains_every_metric_and_control() -> None:
    named = set(re.findall(r"`([\w-]+)`", PAGE))
    for name in set(Metrics.model_fields) - TASK_METRICS:
        assert re.sub("^(comm|renorm)_", "", name) in named, name
    assert {*CONTROLS, INVERTED} <= named
    assert "(metrics.png)" in PAGE
    assert (Path(__file__).parents[3] / "docs" / "metrics.png").is_file()
