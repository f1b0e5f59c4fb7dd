"""Violin plots like the paper's: a panel per cell, the explainers side by side, without and with the term.

A violin is the distribution over the episodes of all policies of the cell, the bar its mean. Text and axes
have one colour, nearly black for print; in the SVG it follows the reader's colour scheme.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xmarl_bench.errors import InputError
from xmarl_bench.papers.kailas2025.claims import ORIENTATION, PAPER_EXPLAINERS, VARIANTS, Cell, Term
from xmarl_bench.papers.kailas2025.results import StudyData
from xmarl_bench.papers.kailas2025.samples import Floats, pooled
from xmarl_bench.papers.kailas2025.tables import METRIC_NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

METRICS = ("fid_delta", "gef", "fid_plus", "fid_minus", "comm_budgeted_fidelity")
INK = "#1b1b1c"  # replaced in the SVG, so no other element may have this colour
# The paper's blue and orange, which colour-blind people can distinguish.
WITHOUT, WITH = "#0072b2", "#e69f00"
STYLE = (
    f"<style>svg{{color-scheme:light dark;color:{INK}}}"
    "@media screen and (prefers-color-scheme:dark){svg{color:#e8e8e8}}</style>"
)
SHORT = {"gnn_explainer": "gnn", "gnn_explainer-tuned": "gnn-tuned", "attention-rowmax": "att-rowmax",
         "graphmask-pyg": "graphmask\n-pyg"}  # fmt: skip


@dataclass(frozen=True)
class Figure:
    name: str
    caption: str
    svg: str  # for screens, light and dark
    pdf: bytes  # for print


def check_matplotlib() -> None:
    """Raise InputError if matplotlib, an optional dependency, is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise InputError(
            "figures need matplotlib, which is not installed: pip install 'xmarl-bench[plots]', or leave "
            "them out with --no-figures."
        ) from None


def figures_of(data: StudyData) -> Iterator[Figure]:
    """A figure per metric and set of explainers: the paper's, their variants, and any others."""
    sets = {
        "paper": [name for name in PAPER_EXPLAINERS if name in data.explainers],
        "variants": [VARIANTS[name] for name in PAPER_EXPLAINERS if VARIANTS[name] in data.explainers],
    }
    drawn = {name for names in sets.values() for name in names}
    sets["others"] = [name for name in data.explainers if name not in drawn]
    for kind, explainers in sets.items():
        for metric in METRICS if explainers else ():
            yield draw(data, metric, kind, explainers)


def draw(data: StudyData, metric: str, kind: str, explainers: Sequence[str]) -> Figure:
    import matplotlib
    from matplotlib.figure import Figure as Canvas
    from matplotlib.patches import Patch

    cells, columns = data.study.cells, data.study.columns
    rows = -(-len(cells) // columns)
    settings: Any = {
        "text.color": INK, "axes.edgecolor": INK, "axes.labelcolor": INK, "xtick.color": INK,
        "ytick.color": INK, "font.size": 9, "svg.fonttype": "none", "svg.hashsalt": f"{metric}-{kind}",
        "pdf.fonttype": 42, "font.family": "sans-serif",
    }  # fmt: skip
    with matplotlib.rc_context(settings):
        canvas = Canvas(figsize=(3.1 * columns, 1.9 * rows + 0.5), layout="constrained")
        panels = canvas.subplots(rows, columns, squeeze=False, sharey="row")
        for panel, cell in zip(panels.flat, cells, strict=False):
            _panel(panel, data, cell, metric, explainers)
        for panel in panels.flat[len(cells) :]:
            panel.set_visible(False)
        arrow = "\u2191" if ORIENTATION[metric] > 0 else "\u2193"
        name = METRIC_NAMES[metric].replace("communication-only budgeted", "comm. budgeted\n")
        for row in panels:
            row[0].set_ylabel(f"{name} {arrow}")
        canvas.legend(
            handles=[Patch(color=WITHOUT, alpha=0.75), Patch(color=WITH, alpha=0.75)],
            labels=["without the term", "with the term"],
            loc="outside lower center", ncols=2, frameon=False,
        )  # fmt: skip
        # No dates, so that the same entries give the same bytes.
        svg, pdf = io.StringIO(), io.BytesIO()
        canvas.savefig(svg, format="svg", transparent=True, metadata={"Date": None})
        canvas.set_layout_engine("none")  # keep the layout of the SVG
        canvas.savefig(pdf, format="pdf", metadata={"CreationDate": None})
    return Figure(
        f"{metric}-{kind}",
        f"{METRIC_NAMES[metric]} {arrow} of {', '.join(explainers)}, by episode; the bar is the mean.",
        adaptive(svg.getvalue()),
        pdf.getvalue(),
    )


def _panel(panel: Axes, data: StudyData, cell: Cell, metric: str, explainers: Sequence[str]) -> None:
    empty = True
    for at, explainer in enumerate(explainers):
        for regularised, colour, offset in ((False, WITHOUT, -0.2), (True, WITH, 0.2)):
            values = pooled(data.samples.runs(cell, Term(explainer), regularised), metric)
            if values.size:
                empty = False
                _violin(panel, values, at + offset, colour)
    panel.set_title(cell.label, fontsize=9)
    panel.set_xticks(range(len(explainers)), [SHORT.get(name, name) for name in explainers])
    panel.set_xlim(-0.6, len(explainers) - 0.4)
    panel.grid(axis="y", color="0.5", alpha=0.25, linewidth=0.5)
    panel.spines[["top", "right"]].set_visible(False)
    panel.patch.set_alpha(0.0)
    if empty:
        panel.text(0.5, 0.5, "not measured", transform=panel.transAxes, ha="center", va="center")


def _violin(panel: Axes, values: Floats, at: float, colour: str) -> None:
    """Draw a violin; only its bar if all values are equal."""
    if np.ptp(values) > 1e-9:
        bodies: Any = panel.violinplot([values], [at], widths=0.36, showextrema=False)["bodies"]
        for body in bodies:
            body.set(facecolor=colour, edgecolor=colour, alpha=0.6, linewidth=0.8)
    panel.hlines(float(values.mean()), at - 0.17, at + 0.17, color=colour, linewidth=1.6)


def adaptive(svg: str) -> str:
    """The SVG element only, with INK replaced by the colour of the reader's scheme."""
    svg = svg[svg.index("<svg") :]
    end = svg.index(">") + 1
    head = svg[:end].replace("<svg", '<svg role="img"', 1)
    return head + STYLE + svg[end:].replace(INK, "currentColor")
