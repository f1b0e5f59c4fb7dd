"""The tier that scores an entry on episodes that were unknown when it was submitted.

Their seeds derive from a value that is fixed after the submission, never from the submission
(`xmarl_bench.reproducible.fresh_seeds`). An explainer that was tuned to the public episodes does worse here.
Behaviour is not rolled out again.
"""

from __future__ import annotations

from dataclasses import dataclass

from xmarl_bench.entry.fresh import differences
from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.entry.provenance import now
from xmarl_bench.entry.schema import Entry, FreshDifference, FreshSeeds
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.reproducible import fresh_seeds
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score_requests


@dataclass(frozen=True)
class Fresh:
    """Differences of public and fresh scores, cell by cell."""

    value: str  # source of the seeds
    episodes: int  # of each cell
    cells: tuple[dict[str, FreshDifference], ...]

    def record(self) -> dict[str, object]:
        """The comparison for JSON."""
        cells = [{name: each.model_dump() for name, each in cell.items()} for cell in self.cells]
        return {"value": self.value, "episodes": self.episodes, "cells": cells}

    def block(self, by: str) -> FreshSeeds:
        """The block of the entry, signed by `by`."""
        return FreshSeeds(value=self.value, by=by, when=now(), episodes=self.episodes, cells=self.cells)


def score_fresh(entry: Entry, policy: Policy, card: PolicyCard, explainer: Explainer, value: str) -> Fresh:
    """Score as many fresh episodes of each cell as the entry has public ones, at as many timesteps.

    Raises InputError if the value is not a valid source of seeds, or if the explainer fails.
    """
    protocol, cells = entry.protocol, []
    seeds = tuple(fresh_seeds(PROTOCOL, value, protocol.episodes))
    for cell in entry.results:
        sampling = Sampling(
            protocol.episodes, protocol.timesteps, cell.max_cycles, entry.explainer.seed, seeds
        )
        request = Request(policy, card, explainer, (Cell(cell.task, cell.n_agents),), sampling, 0)
        (again,) = entries_of(score_requests([request]))
        (found,) = again.results
        cells.append(differences(cell, found))
    return Fresh(value, protocol.episodes, tuple(cells))
