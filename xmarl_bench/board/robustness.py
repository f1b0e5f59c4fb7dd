"""What the answers of a board rest on.

Does the first lead without the absence model that it assumes itself? Does the entropy term move one explainer
alone? What of pairs of runs that the board does not rank?
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from xmarl_bench.board.answer import answer_of, difference, effect_of
from xmarl_bench.board.entry_rows import Json
from xmarl_bench.board.regulariser import (
    compared,
    families_of,
    regulariser_of,
    score_of,
    task_metric_of,
)
from xmarl_bench.board.scores import Scores
from xmarl_bench.counted import counted
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.metrics.statistics import Difference
from xmarl_bench.metrics.table import ORDER, SUCCESS, UNDER_ABSENCES, by_name


def answer_by(scores: Scores) -> list[str]:
    """`answer_of` the ranking, with what its lead rests on."""
    said, lead = answer_of(scores.ranking), lead_without_zero(scores)
    return [*said[:2], lead, *said[2:]] if lead else said  # the second sentence tells the lead


def lead_without_zero(scores: Scores) -> str:
    """The first explainer's lead by the absence models other than `zero`, which many explainers assume.

    Empty without a lead, or if the other models were not measured.
    """
    found = _without_zero(scores)
    if found is None:
        return ""
    rests = "does not rest on" if _shows_the_lead(found) else "rests on"
    shown = difference({"difference": found.value, "interval": found.interval})
    first, second = scores.explainers[0], scores.ranking["lead"]["over"]
    return (
        f"That lead {rests} the absence model `{Absence.ZERO}`, which Shapley values and occlusion assume "
        f"themselves: by the mean of the other three, `{first}` less `{second}` is {shown}."
    )


def rests_on_zero(scores: Scores) -> bool:
    """Whether the other absence models do not show the first explainer's lead."""
    found = _without_zero(scores)
    return found is not None and not _shows_the_lead(found)


def _shows_the_lead(difference: Difference) -> bool:
    return not difference.holds_zero and (difference.value or 0.0) > 0.0


def _without_zero(scores: Scores) -> Difference | None:
    lead = scores.ranking["lead"]
    if lead is None or lead["interval"] is None:
        return None
    _, *others = UNDER_ABSENCES
    found = scores.difference_over(others, scores.explainers[0], lead["over"])
    return None if found.value is None or found.interval is None else found


def others_with_term(families: Sequence[Json], name: str, first: str) -> str:
    """What the entropy term does to the other explainers, and to one beside the first of the board.

    Empty if the explainers have no pair of runs, or the name is that of the first.
    """
    terms = regulariser_of(families)
    if name == first or name not in terms or first not in terms:
        return ""
    effect = effect_of(terms[name])
    others = [found for each, found in terms.items() if each != name]
    alike = sum(effect_of(found) == effect for found in others)

    def beside(policy: Json) -> float | None:
        ours, theirs = (score_of(policy, each) for each in (name, first))
        return None if ours is None or theirs is None else ours - theirs

    more = compared(families, beside)
    assert more is not None  # both have pairs of the same policies
    return (
        f"It {effect} that of {alike} of the {len(others)} other explainers too, and changes that of "
        f"`{first}` by {difference(terms[first])}; `{name}` less `{first}` changes by {difference(more)}."
    )


def with_gated_pairs(tables: Sequence[Json], name: str) -> str:
    """What the entropy term does if pairs count of which a policy is not ranked; empty without such pairs."""
    families = families_of(tables, gated=True)
    left_out = _n_pairs(families) - _n_pairs(families_of(tables))
    fidelity = compared(families, partial(score_of, explainer=name))
    success = compared(families, partial(task_metric_of, metric=SUCCESS))
    if not left_out or fidelity is None or success is None:
        return ""
    pairs = f"{counted(left_out, 'pair')} {'is' if left_out == 1 else 'are'}"
    return (
        f"{pairs} left out, because the board does not rank one of the policies or both; with them the "
        f"differences are {difference(fidelity)} in {by_name()[ORDER].title} and {difference(success)} in "
        f"success."
    )


def _n_pairs(families: Sequence[Json]) -> int:
    return sum(len(family["pairs"]) for family in families)
