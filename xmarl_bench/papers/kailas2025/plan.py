"""The three studies: their policies, cells and statements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.papers.kailas2025 import main_claims, training_claims, zero_shot_claims
from xmarl_bench.papers.kailas2025.beyond_claims import BEYOND_CLAIMS
from xmarl_bench.papers.kailas2025.claims import PAPER_EXPLAINERS, VARIANTS, Cell, Claim
from xmarl_bench.papers.kailas2025.main_claims import MAIN_CLAIMS
from xmarl_bench.papers.kailas2025.paper import NAVIGATION, TRAINING
from xmarl_bench.papers.kailas2025.samples import percent_of
from xmarl_bench.papers.kailas2025.training_claims import TRAINING_CLAIMS
from xmarl_bench.papers.kailas2025.zero_shot_claims import ZERO_SHOT_CLAIMS
from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.rollout.cell import Cell as TaskCell
from xmarl_bench.rollout.cell import Sampling
from xmarl_bench.scoring.arguments import ALL, check_among
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.selection import select_policies

EXPLAINERS = (*PAPER_EXPLAINERS, *(VARIANTS[name] for name in PAPER_EXPLAINERS))


@dataclass(frozen=True)
class Study:
    """A study. columns: of its figures, as in the paper."""

    name: str
    title: str
    cells: tuple[Cell, ...]
    columns: int
    claims: tuple[Claim, ...]
    beyond: tuple[Claim, ...] = ()


# Finished policies are shown together with the paper's three checkpoints of training.
FINISHED = Cell(NAVIGATION, training_claims.N_AGENTS)
STUDIES = {
    study.name: study
    for study in (
        Study(
            "main",
            "Three tasks, three team sizes",
            main_claims.CELLS,
            3,
            MAIN_CLAIMS,
            BEYOND_CLAIMS,
        ),
        Study(
            "training",
            "Along training: navigation, three agents",
            (*training_claims.CELLS, FINISHED),
            len(TRAINING) + 1,
            TRAINING_CLAIMS,
        ),
        Study(
            "zero-shot",
            "Larger teams than in training: navigation",
            zero_shot_claims.CELLS,
            3,
            ZERO_SHOT_CLAIMS,
        ),
    )
}
QUICK = Sampling(episodes=4, timesteps=4)


def select_study_policies(study: Study, names: Sequence[str]) -> list[tuple[Policy, PolicyCard, Cell]]:
    """Each policy with every cell of the study that it belongs to, cell by cell.

    Raises InputError if no policy belongs to a cell.
    """
    policies = [(policy, card) for policy, card, _ in select_policies(names, [ALL], [ALL])]
    chosen = [
        (policy, card, cell)
        for cell in study.cells
        for policy, card in policies
        if (card.task, card.n_agents, percent_of(card)) == (cell.task, cell.n_trained, cell.percent)
    ]
    if not chosen:
        raise InputError(
            f"none of {len(policies)} policies belongs to the study {study.name!r} "
            f"({study.cells[0].label}, ...): choose others with --policy."
        )
    return chosen


def plan(
    study: Study,
    names: Sequence[str],
    explainers: Sequence[Explainer],
    sampling: Sampling,
    behaviour: Sequence[str] = (),
) -> list[Request]:
    """One request per policy, cell and explainer; one cell per entry.

    behaviour: explainers whose masks the team also plays on, or ALL. Raises InputError for the name of
    another explainer.
    """
    check_among(behaviour, [explainer.name for explainer in explainers])
    return [
        Request(
            policy,
            card,
            explainer,
            (TaskCell(cell.task, cell.n_trained + (cell.more or 0)),),
            sampling,
            sampling.episodes if ALL in behaviour or explainer.name in behaviour else 0,
        )
        for policy, card, cell in select_study_policies(study, names)
        for explainer in explainers
    ]
