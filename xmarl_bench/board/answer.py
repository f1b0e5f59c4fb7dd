"""What a ranking says, in sentences: who leads, by how much, how surely, and who is no better than a control.

Names of explainers and controls stand in backquotes. The rankings are those of `board_of`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from xmarl_bench.board.columns import GAMED, ORDER
from xmarl_bench.board.over_policies import BEATEN
from xmarl_bench.counted import counted
from xmarl_bench.explain.control_names import BY_ZERO, RANDOM
from xmarl_bench.metrics.table import by_name

MOST_NAMED = 6
METRIC = by_name()[ORDER["by"]]
Json = dict[str, Any]


def number(value: float | None, digits: int = METRIC.digits) -> str:
    """The value as every page shows it: rounded once, with a minus sign; an en dash for None."""
    if value is None:
        return "\u2013"
    text = f"{value:.{digits}f}"
    return (text.removeprefix("-") if float(text) == 0.0 else text).replace("-", "\u2212")


def answer_of(ranking: Json | None) -> list[str]:
    """Sentences: the leader, then those that are not shown to be better than each control."""
    ranked = [] if ranking is None else [row for row in ranking["rows"] if row["rank"] is not None]
    if ranking is None or not ranked:
        return [
            "Nothing is ranked here: no policy passes the gate, all scores are partial, or explainers share "
            "too few policies."
        ]
    ranked.sort(key=lambda row: row["rank"])
    best = [row for row in ranked if row["rank"] == 1]
    names = _listed([row["explainer"] for row in best])
    over = _policies(best[0], ranking)
    said = [
        f"{names} {_verb(best, 'leads', 'lead')} with a {METRIC.title} of {_value(best[0])}, over {over}."
    ]
    if best[0]["rank_interval"] is None:
        unit = "episode" if best[0]["n_policies"] == 1 else "training"
        return [*said, f"Nothing is tested: one {unit} gives no interval."]
    if len(ranked) > len(best):
        said.append(_lead(ranking["lead"], [row for row in ranked[len(best) :] if row["ties_first"]]))
    if not any(beats(row, RANDOM) for row in ranked):
        said = [f"No explainer is shown to be better than a `{RANDOM}` ranking. {said[0]}"]
    return said + _not_beaten(ranked)


def beats(row: Json, control: str) -> bool | None:
    """Whether a ranked explainer is above the control, by a 95 % interval; None if that is unknown."""
    above = row["above"][control]
    return None if above is None or above["interval"] is None else above["interval"][0] > 0.0


def answer_about(name: str, ranking: Json | None) -> list[str]:
    """Sentences about one explainer of a ranking."""
    ranking = ranking or {"rows": []}
    row = next((r for r in ranking["rows"] if r["explainer"] == name), None)
    if row is None:
        return [f"`{name}` is not ranked here: it was scored on no policy that is."]
    if row["rank"] is None:
        return [f"`{name}` is not ranked here: {row.get('reason', 'it is a control')}."]
    ranked = sum(each["rank"] is not None for each in ranking["rows"])
    within = "" if row["rank_interval"] is None else " (95 %: {} to {})".format(*row["rank_interval"])
    said = [
        f"`{name}` has rank {row['rank']} of {ranked}{within}, with a {METRIC.title} of {_value(row)}, over "
        f"{_policies(row, ranking)}."
    ]
    for control in BEATEN:
        above = row["above"][control]
        if above is not None and above["interval"] is not None:
            shown = "is better" if beats(row, control) else "is not shown to be better"
            said.append(f"It {shown} than `{control}`: by {difference(above)}.")
    return said


def answer_on_term(name: str, found: Json | None) -> str:
    """What attention-entropy regularisation does to an explainer; found: its part of `regulariser_of`."""
    if found is None:
        return (
            f"No pair of ranked policies with and without attention-entropy regularisation has scores of "
            f"`{name}`."
        )
    return (
        f"Attention-entropy regularisation {effect_of(found)} the {METRIC.title} of `{name}`: "
        f"{number(found['without'])} without and {number(found['with'])} with it, a difference of "
        f"{difference(found)}, over {counted(found['n'], 'pair')} of training runs."
    )


def effect_of(found: Json) -> str:
    """What a difference and its interval allow to say of the term: a verb."""
    interval = found["interval"]
    if interval is None or interval[0] <= 0.0 <= interval[1]:
        return "is not shown to change"
    return "raises" if found["difference"] > 0.0 else "lowers"


def gamed_by(rows: Sequence[Json]) -> str:
    """How a control and the first explainer compare by the metric that can be gamed, and by the order.

    The control is the best by that metric of those that know nothing: not an oracle, which is made to win it.
    """
    gamed = by_name()[GAMED].title
    known = [row for row in rows if row["means"][GAMED] is not None]
    first = next((row for row in known if row["rank"] is not None), None)
    fooling = [row for row in known if row["control"] and row["explainer"] not in BY_ZERO]
    fooling = [row for row in fooling if row["value"] < 0.5]
    if first is None or not fooling:
        return ""
    control = max(fooling, key=lambda row: row["means"][GAMED])
    return (
        f"The control `{control['explainer']}` gets a {gamed} of {number(control['means'][GAMED])} and a "
        f"{METRIC.title} of {number(control['value'])}; `{first['explainer']}`, the first, gets "
        f"{number(first['means'][GAMED])} and {number(first['value'])}."
    )


def _lead(lead: Json | None, ties: Sequence[Json]) -> str:
    names = _listed([row["explainer"] for row in ties])
    if lead is None:
        return "No other explainer differs significantly from the first."
    same = (
        f"{names} {_verb(ties, 'does', 'do')} not differ significantly from the first; the best that does, "
        if ties
        else "The next, "
    )
    return f"{same}`{lead['over']}`, is {difference(lead)} below."


def _not_beaten(ranked: Sequence[Json]) -> list[str]:
    said = []
    for control in BEATEN:
        known = [row for row in ranked if beats(row, control) is not None]
        failed = [row["explainer"] for row in known if not beats(row, control)]
        if failed and len(failed) < len(ranked):
            said.append(f"Not shown to be better than `{control}`: {_listed(failed)}.")
        elif failed and control != RANDOM:
            said.append(f"None is shown to be better than `{control}`.")
        elif known and not failed:
            said.append(
                f"All are better than `{control}`." if len(known) > 1 else f"It is better than `{control}`."
            )
    return said


def _value(row: Json) -> str:
    interval = row["interval"]
    known = "" if interval is None else f" (95 %: {number(interval[0])} to {number(interval[1])})"
    return number(row["value"]) + known


def difference(found: Json) -> str:
    """A difference with its interval."""
    interval = found["interval"]
    known = "" if interval is None else f" ({number(interval[0])} to {number(interval[1])})"
    return number(found["difference"]) + known


def _policies(row: Json, ranking: Json) -> str:
    if row["n_policies"] == 1:
        return "1 policy, whose episodes are the units"
    cells, n = ranking["n_cells"], ranking["n_trainings"]
    where = "" if cells == 1 else f" in {cells} cells"
    independent = "" if n == row["n_policies"] else f" ({counted(n, 'independent training')})"
    return f"{row['n_policies']} policies{where}{independent}"


def _verb(rows: Sequence[Json], one: str, several: str) -> str:
    return one if len(rows) == 1 else several


def _listed(names: Sequence[str]) -> str:
    """`a`, `b` and `c`; the end of a long list is counted."""
    quoted = [f"`{name}`" for name in names[:MOST_NAMED]]
    rest = len(names) - MOST_NAMED
    if rest > 0:
        quoted.append(f"{rest} {'other' if rest == 1 else 'others'}")
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} and {quoted[-1]}" if quoted else ""
