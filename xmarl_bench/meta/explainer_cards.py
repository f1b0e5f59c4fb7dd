"""What the board's page tells of explainers besides their scores: question, paper and planted truth.

They are not in entries, which hold measurements. `xmarl-bench board explainers` writes them to
`explainers.json` beside the entries, for every explainer that is registered where it runs.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Sequence
from typing import Any

from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.meta.planted_suite import by_family, score_planted

PAPER = re.compile(r"Paper(?: and formula)?: (.*?)(?:\.\s+Formula\b|(?<=\))\.\s|\n\n|\Z)", re.DOTALL)


def cards_of(explainers: Sequence[Explainer], **planted: Any) -> dict[str, dict[str, Any]]:
    """Name -> summary, absence model, paper, and AUROC on each planted family; None where unknown.

    planted: options of `score_planted`.
    """
    found = score_planted(explainers, **planted)
    return {
        each.name: {
            "summary": each.summary,
            "absence": None if each.absence is None else str(each.absence),
            "paper": paper_of(each),
            "planted": {family: round(x, 6) for family, x in by_family(found, each.name, "auroc").items()},
        }
        for each in explainers
        if not each.control
    }


def paper_of(explainer: Explainer) -> str | None:
    """The paper that the docstring of the explainer's module names after "Paper:"."""
    if explainer.origin is None:
        return None
    module = importlib.import_module(explainer.origin.entry_point.partition(":")[0])
    found = PAPER.search(inspect.getdoc(module) or "")
    return None if found is None else " ".join(found[1].split()).rstrip(".")
