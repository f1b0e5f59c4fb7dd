"""A comparison as a picture: means and differences with their intervals, and performance profiles."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from xmarl_bench.compare.comparison import Comparison
from xmarl_bench.counted import counted
from xmarl_bench.errors import InputError
from xmarl_bench.metrics.statistics import Difference
from xmarl_bench.records.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMATS = (".png", ".svg", ".pdf")
# For tie groups in order; colour-blind people can distinguish these colours (Okabe and Ito).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
DASHES = ("-", "--", ":", "-.")
GREY = "#777777"
SIGNIFICANT = 0.05


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
    """One row per metric: means, differences of all pairs, profiles. Equal comparisons give equal bytes."""
    import matplotlib
    from matplotlib.figure import Figure

    heights = [max(2.4, 0.6 + 0.26 * max(len(each.standings), len(each.pairs))) for each in comparisons]
    with matplotlib.rc_context({"font.size": 9, "svg.hashsalt": "compare", "pdf.fonttype": 42}):
        figure = Figure(figsize=(15, sum(heights) + 0.6), layout="constrained")
        panels = figure.subplots(len(comparisons), 3, squeeze=False, height_ratios=heights)
        for (left, right, profiles), each in zip(panels, comparisons, strict=True):
            _profiles(profiles, each)
            names = [standing.explainer for standing in each.standings]
            for k, standing in enumerate(each.standings):
                _interval(left, k, standing.mean, COLOURS[(standing.tie_group - 1) % len(COLOURS)])
            left.set_yticks(range(len(names)), names)
            left.set_title(f"{each.metric}, {each.better} is better; one colour: tied", fontsize=9)
            for k, pair in enumerate(each.pairs):
                filled = pair.p_holm is not None and pair.p_holm < SIGNIFICANT
                _interval(right, k, pair.difference, GREY if pair.difference.holds_zero else "black", filled)
            right.axvline(0.0, color=GREY, linewidth=0.8)
            right.set_yticks(range(len(each.pairs)), [f"{pair.first} - {pair.second}" for pair in each.pairs])
            right.set_title(f"difference; filled: Holm p < {SIGNIFICANT}", fontsize=9)
            for panel, n_rows in ((left, len(names)), (right, len(each.pairs))):
                panel.set_ylim(n_rows - 0.5, -0.5)  # the first on top
                panel.spines[["top", "right"]].set_visible(False)
        n = len(comparisons[0].states)
        over = counted(n, "policy") if n > 1 else "the episodes of one policy"
        figure.supxlabel(f"95 % intervals over {over}", fontsize=9)
        data = io.BytesIO()
        metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix)
        figure.savefig(data, format=path.suffix[1:], dpi=150, metadata=metadata)
    write_atomically(path, data.getvalue())


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


def _interval(panel: Axes, y: int, difference: Difference, colour: str, filled: bool = True) -> None:
    value = difference.value if difference.value is not None else float("nan")
    if difference.interval is not None:
        panel.hlines(y, *difference.interval, color=colour, linewidth=2)
    panel.plot(value, y, "o", color=colour, markerfacecolor=colour if filled else "white", markersize=6)
