"""A comparison as a picture: means with their intervals and tie groups, differences, performance profiles."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from xmarl_bench.compare.comparison import Comparison
from xmarl_bench.counted import counted
from xmarl_bench.errors import InputError
from xmarl_bench.records.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
# Of the profiles, in order; colour-blind people can distinguish these colours (Okabe and Ito).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
DASHES = ("-", "--", ":", "-.", (0, (8, 3)), (0, (1, 4)))
GREY, BAND = "#777777", "#eef1f5"
BETTER, MAYBE = "#9ecae1", "#deebf7"  # cells of a significant difference, and of one by its interval alone
SIGNIFICANT = 0.05
ROW, CELL, CHARACTER = 0.34, 0.62, 0.075  # inches: a row, a column of the differences, a letter of a name


def check_picture(path: Path) -> None:
    """Raise InputError, before any work, for an unsupported format or if matplotlib is missing."""
    if path.suffix not in FORMATS:
        raise InputError(
            f"{path} is not a supported picture: give a name that ends in one of {', '.join(FORMATS)}."
        )
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise InputError(
            "pictures need matplotlib, which is not installed: pip install 'xmarl-bench[plots]', or leave "
            "--plot out."
        ) from None


def draw(comparisons: Sequence[Comparison], path: Path) -> None:
    """Write the picture. Equal comparisons give equal bytes."""
    import matplotlib

    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix)
    data = io.BytesIO()
    with matplotlib.rc_context({"font.size": 9, "svg.hashsalt": "compare", "pdf.fonttype": 42}):
        figure_of(comparisons).savefig(data, format=path.suffix[1:], dpi=150, metadata=metadata)
    write_atomically(path, data.getvalue())


def figure_of(comparisons: Sequence[Comparison]) -> Figure:
    """One row per metric: means, differences of all pairs, profiles; as large as names and numbers need."""
    from matplotlib.figure import Figure

    n = max(len(each.standings) for each in comparisons)
    name = CHARACTER * max(len(standing.explainer) for each in comparisons for standing in each.standings)
    widths = [name + 4.0, name + max(2.0, CELL * n), name + 4.5]
    heights = [1.2 + name + max(2.0, ROW * len(each.standings)) for each in comparisons]
    figure = Figure(figsize=(sum(widths) + 0.6, sum(heights) + 0.6), layout="constrained")
    panels = figure.subplots(len(comparisons), 3, squeeze=False, height_ratios=heights, width_ratios=widths)
    for (left, middle, right), each in zip(panels, comparisons, strict=True):
        _means(left, each)
        _differences(middle, each)
        _profiles(right, each)
    several = len(comparisons[0].states) > 1
    over = counted(comparisons[0].trainings, "training") if several else "the episodes of one policy"
    figure.supxlabel(f"95 % intervals over {over}", fontsize=9)
    return figure


def _means(panel: Axes, comparison: Comparison) -> None:
    """The explainers in order, with a band and a number for each tie group."""
    standings = comparison.standings
    for k, standing in enumerate(standings):
        mean = standing.mean
        if mean.interval is not None:
            panel.hlines(k, *mean.interval, color="black", linewidth=2)
        panel.plot(
            mean.value if mean.value is not None else float("nan"), k, "o", color="black", markersize=6
        )
    for group in sorted({standing.tie_group for standing in standings}):
        rows = [k for k, standing in enumerate(standings) if standing.tie_group == group]
        if group % 2:
            panel.axhspan(rows[0] - 0.5, rows[-1] + 0.5, color=BAND, zorder=0)
        middle = (rows[0] + rows[-1]) / 2
        panel.annotate(
            f"{group}", (1.01, middle), xycoords=("axes fraction", "data"), va="center", color=GREY
        )
    _rows(panel, [standing.explainer for standing in standings])
    panel.set_title(
        f"{comparison.metric}, {comparison.better} is better\none band and number: tied", fontsize=9
    )


def _differences(panel: Axes, comparison: Comparison) -> None:
    """Row less column: the number, and by the colour of the cell how surely they differ."""
    names = [standing.explainer for standing in comparison.standings]
    at = {name: k for k, name in enumerate(names)}
    for pair in comparison.pairs:
        row, column = at[pair.first], at[pair.second]
        value = pair.difference.value
        sure = pair.p_holm is not None and pair.p_holm < SIGNIFICANT
        colour = BETTER if sure else "white" if pair.difference.holds_zero else MAYBE
        panel.fill_between([column - 0.5, column + 0.5], row - 0.5, row + 0.5, color=colour, linewidth=0)
        panel.text(
            column, row, "-" if value is None else f"{value:.2g}", ha="center", va="center", fontsize=8
        )
    _rows(panel, names)
    panel.set_xlim(-0.5, len(names) - 0.5)
    panel.set_xticks(range(len(names)), names, rotation=90)
    panel.set_title(
        f"row less column; dark: Holm p < {SIGNIFICANT},\nlight: only the 95 % interval excludes 0",
        fontsize=9,
    )


def _rows(panel: Axes, names: Sequence[str]) -> None:
    panel.set_yticks(range(len(names)), names)
    panel.set_ylim(len(names) - 0.5, -0.5)  # the first on top
    panel.spines[["top", "right"]].set_visible(False)


def _profiles(panel: Axes, comparison: Comparison) -> None:
    """A curve for each explainer, best first, and the band of the best only: more would hide the curves."""
    low = min(standing.profile.taus[0] for standing in comparison.standings)
    high = max(standing.profile.taus[-1] for standing in comparison.standings)
    beyond = 0.05 * (high - low or 1.0)
    for k, standing in enumerate(comparison.standings):
        profile, colour = standing.profile, COLOURS[k % len(COLOURS)]
        taus = (low - beyond, *profile.taus, high + beyond)
        shares = (*profile.shares, profile.shares[-1])
        style = DASHES[k // len(COLOURS) % len(DASHES)]
        panel.step(taus, shares, where="post", color=colour, linestyle=style, label=standing.explainer)
        if k == 0:
            least, most = zip(*profile.band, profile.band[-1], strict=True)
            panel.fill_between(taus, least, most, step="post", color=colour, alpha=0.15, linewidth=0)
    panel.set_ylim(-0.02, 1.02)
    panel.set_title("share above tau, 95 % band of the first", fontsize=9)
    panel.set_xlabel(f"tau, {comparison.metric}", fontsize=9)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
