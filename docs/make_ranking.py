"""Writes the answer and the ranking that README.md shows, from leaderboard/leaderboard.json.

    .venv/bin/python docs/make_ranking.py

Run it after the board was built; tests/docs/test_readme.py fails until then.
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

from xmarl_bench.board.answer import answer_of, answer_on_term, gamed_by, number
from xmarl_bench.board.regulariser import families_of, regulariser_of
from xmarl_bench.board.robustness import lead_without_zero, others_with_term
from xmarl_bench.board.scores import Scores, overall_ranking
from xmarl_bench.counted import counted
from xmarl_bench.records.markdown import markdown_table, rewrite, with_part

ROOT = Path(__file__).parent.parent

CONTROLS = {
    "all-ones": "the mask of ones",  # FidDelta cannot tell it from the best one
    "nearest": "the nearest agent",
    "initial-attention": "attention before training",
}


def answer(board: dict[str, Any]) -> str:
    """Points: who leads, how surely; who does not beat a control; what the mask of ones and the term do."""
    scores = Scores.of(board)
    families, said = families_of(scores.tables), answer_of(scores.ranking)
    gain = regulariser_of(families).get("attention")
    points = (
        [*said[:2], lead_without_zero(scores)],
        said[2:],
        [gamed_by(scores.ranking["rows"])],
        [answer_on_term("attention", gain), others_with_term(families, "attention", scores.explainers[0])],
    )
    texts = (" ".join(each for each in sentences if each) for sentences in points)
    return "".join(f"{_point(text)}\n" for text in texts if text)


def _point(text: str) -> str:
    return textwrap.fill(text, 118, initial_indent="- ", subsequent_indent="  ", break_on_hyphens=False)


def section(ranking: dict[str, Any]) -> str:
    """The explainers and three controls in order."""
    about = (
        f"Means over {counted(ranking['n_cells'], 'cell')}, tasks with a team size, which weigh the same, of "
        f"{counted(len(ranking['policies']), 'policy')} (`make rescore`); 0 is a random ranking of the "
        f"messages and 1 the best one:"
    )
    rows = []
    for row in ranking["rows"]:
        if row["control"] and row["explainer"] not in CONTROLS:
            continue
        name = f"{CONTROLS[row['explainer']]}, a control" if row["control"] else row["explainer"]
        if not row["control"] and row["rank"] is None:
            name += f", not ranked: {row['reason']}"
        interval = (
            "" if row["interval"] is None else " [{}, {}]".format(*(number(x, 2) for x in row["interval"]))
        )
        value, fid_delta = number(row["value"], 2), number(row["means"]["fid_delta"], 2)
        rows.append((name, value + interval, fid_delta))
    table = markdown_table(("explainer", "message fidelity", "FidDelta"), rows)
    return f"{textwrap.fill(about, 118)}\n\n{table}"


def page(text: str, leaderboard: dict[str, Any]) -> str:
    """The README with its answer and its ranking, over all tasks and team sizes."""
    text = with_part(text, "answer", answer(leaderboard))
    return with_part(text, "ranking", section(overall_ranking(leaderboard)))


def built() -> dict[str, Any]:
    leaderboard: dict[str, Any] = json.loads((ROOT / "leaderboard" / "leaderboard.json").read_bytes())
    return leaderboard


if __name__ == "__main__":
    rewrite(ROOT / "README.md", lambda text: page(text, built()))
