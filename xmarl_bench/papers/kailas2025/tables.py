"""Tables of a study from its results, in Markdown and LaTeX (booktabs)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from xmarl_bench.metrics.table import METRICS
from xmarl_bench.papers.kailas2025.claims import ORIENTATION
from xmarl_bench.papers.kailas2025.ledger import Verdict
from xmarl_bench.papers.kailas2025.results import QUALITY
from xmarl_bench.records.markdown import markdown_table

Json = dict[str, Any]
METRIC_NAMES = {metric.name: metric.title for metric in METRICS}
ESCAPED = {"\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "_": r"\_", "#": r"\#", "$": r"\$",
           "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
           "<": "$<$", ">": "$>$", "\u00b1": r"$\pm$"}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """A table of texts; all columns but the first `n_names` are numbers."""

    name: str  # of its files
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    n_names: int

    def markdown(self) -> str:
        return markdown_table(self.header, self.rows, self._numbers)

    def latex(self) -> str:
        """As LaTeX, with the package booktabs."""
        body = [" & ".join(map(latex, row)) + r" \\" for row in self.rows]
        return "\n".join(
            [
                r"\begin{table}", r"\centering", r"\caption{" + latex(self.caption) + "}",
                r"\begin{tabular}{" + "l" * self.n_names + "r" * self._numbers + "}", r"\toprule",
                " & ".join(map(latex, self.header)) + r" \\", r"\midrule", *body, r"\bottomrule",
                r"\end{tabular}", r"\end{table}",
            ]
        ) + "\n"  # fmt: skip

    @property
    def _numbers(self) -> int:
        return len(self.header) - self.n_names


def tables_of(results: Json) -> list[Table]:
    tables = [
        quality_table(results, metric)
        for metric in QUALITY
        if any(each["metric"] == metric for each in results["quality"])
    ]
    return [*tables, performance_table(results), ledger_table(results, "ledger"), lens_table(results)] + (
        [ledger_table(results, "beyond")] if results["beyond"] else []
    )


def quality_table(results: Json, metric: str) -> Table:
    """A row per cell and explainer, without and with the term: mean and interval over policies."""
    records = {
        (each["cell"], each["explainer"], each["regularised"]): each
        for each in results["quality"]
        if each["metric"] == metric
    }
    cells = list(dict.fromkeys(cell for cell, _, _ in records))
    explainers = list(dict.fromkeys(explainer for _, explainer, _ in records))
    rows = [
        (cell, explainer, *(_interval(records.get((cell, explainer, each))) for each in (False, True)))
        for cell in cells
        for explainer in explainers
    ]
    direction = {1: " (higher is better)", -1: " (lower is better)"}.get(ORIENTATION.get(metric, 0), "")
    return Table(
        metric,
        f"{_capital(METRIC_NAMES[metric])}{direction}: mean over training runs and Student's 95 % "
        "interval over them.",
        ("cell", "explainer", "without the term", "with the term"),
        tuple(rows),
        2,
    )


def performance_table(results: Json) -> Table:
    """The paper's layout: a row per cell and measure, without and with the term, ours and the paper's."""
    records = {(each["cell"], each["measure"], each["regularised"]): each for each in results["performance"]}
    rows = []
    for cell, measure in dict.fromkeys((cell, measure) for cell, measure, _ in records):
        pair = [records.get((cell, measure, regularised)) for regularised in (False, True)]
        rows.append(
            (
                cell,
                _capital(METRIC_NAMES[measure]),
                *(text for each in pair for text in (_spread(each), _spread(each and each["paper"]))),
            )
        )
    return Table(
        "performance",
        "Task performance, mean and standard deviation over the episodes of all policies of a cell, ours and "
        "the paper's.",
        ("cell", "measure", "without the term", "paper", "with the term", "paper"),
        tuple(rows),
        2,
    )


def ledger_table(results: Json, part: str) -> Table:
    """A row per statement, with the numbers of its decisive comparison."""
    rows = []
    for claim in results[part]:
        shown = decisive(claim)
        counts = claim["counts"]
        rows.append(
            (
                claim["lines"], claim["text"], claim["quantifier"], claim["verdict"],
                " / ".join(str(counts[verdict]) for verdict in Verdict),
                METRIC_NAMES[shown["metric"]], difference(shown), _number(shown["effect"]), p_value(shown),
            )
        )  # fmt: skip
    captions = {
        "ledger": "The paper's statements (lines of paper.tex) on our policies.",
        "beyond": "Our own statements, beyond the paper.",
    }
    return Table(
        part,
        captions[part]
        + " Cells: held / reverse shown / not decided / not measured. Difference: mean over all "
        "policies, positive as claimed, with its 95 % interval; effect: rank-biserial correlation.",
        ("lines", "statement", "asked of", "verdict", "cells", "metric", "difference", "effect", "p"),
        tuple(rows),
        4,
    )


def lens_table(results: Json) -> Table:
    """A row per statement, a column per lens: the verdict, or a dash if the lens does not change it."""
    seen = {
        (lens["name"], claim["id"]): claim["verdict"]
        for lens in results["lenses"]
        for claim in lens["claims"]
    }
    names = [lens["name"] for lens in results["lenses"]]
    rows = [
        (claim["text"], claim["verdict"], *(seen.get((name, claim["id"]), "-") for name in names))
        for claim in results["ledger"]
        if any((name, claim["id"]) in seen for name in names)
    ]
    return Table(
        "lenses",
        "The same statements with other variants of the explainers and other metrics.",
        ("statement", "as in the paper", *names),
        tuple(rows),
        2 + len(names),
    )


def decisive(claim: Json) -> Json:
    """The decisive contrast over all policies: the first with the same verdict, else the first not held."""
    overall: Sequence[Json] = claim["overall"]
    same = [each for each in overall if each["verdict"] == claim["verdict"]]
    open_ = [each for each in overall if each["verdict"] != Verdict.HELD]
    return [*same, *open_, *overall][0]


def difference(contrast: Json) -> str:
    if contrast["difference"] is None:
        return "-"
    value = f"{contrast['difference']:+.3f}"
    interval = contrast["interval"]
    return value if interval is None else f"{value} [{interval[0]:.3f}, {interval[1]:.3f}]"


def p_value(contrast: Json) -> str:
    """The p-value after Bonferroni."""
    p = contrast["p_adjusted"]
    return "-" if p is None else "< 0.001" if p < 0.001 else f"{p:.3f}"


def latex(text: str) -> str:
    return "".join(ESCAPED.get(character, character) for character in text)


def _interval(record: Json | None) -> str:
    if record is None:
        return "-"
    value, interval = f"{record['mean']:.3f}", record["interval"]
    return value if interval is None else f"{value} [{interval[0]:.3f}, {interval[1]:.3f}]"


def _spread(record: Json | None) -> str:
    return "-" if record is None or record["mean"] is None else f"{record['mean']:.2f} ± {record['std']:.2f}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:+.2f}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
