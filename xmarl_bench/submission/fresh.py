"""The tier that scores an entry on episodes that nobody knew when it was submitted.

Their seeds are derived from a value that is fixed after the submission, never from anything in it
(`xmarl_bench.reproducible.fresh_seeds`). An explainer that was chosen on the public episodes, or knows them,
does worse here. Behaviour is not acted out again.
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
    """Public less fresh, cell by cell."""

    value: str  # from which the seeds are derived
    episodes: int  # of each cell
    cells: tuple[dict[str, FreshDifference], ...]

    def record(self) -> dict[str, object]:
        """For programs."""
        cells = [{name: each.model_dump() for name, each in cell.items()} for cell in self.cells]
        return {"value": self.value, "episodes": self.episodes, "cells": cells}

    def block(self, by: str) -> FreshSeeds:
        """Signed off."""
        return FreshSeeds(value=self.value, by=by, when=now(), episodes=self.episodes, cells=self.cells)


def score_fresh(entry: Entry, policy: Policy, card: PolicyCard, explainer: Explainer, value: str) -> Fresh:
    """Score as many fresh episodes of each cell as the entry has public ones, at as many timesteps.

    Raises InputError if the value is no source of seeds, or the explainer fails.
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
