"""`xmarl-bench compare`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xmarl_bench.cli.options import AsJson

if TYPE_CHECKING:
    from xmarl_bench.compare.comparison import Comparison
    from xmarl_bench.entry.schema import Entry
    from xmarl_bench.metrics.statistics import Difference

ALL_PAIRS = 6  # explainers: of more, only the pairs with the first are printed


def compare(
    entry: Annotated[
        list[str],
        typer.Argument(
            help="Entry files, folders of entries or of `score`, bundles, or explainers named in --entries."
        ),
    ],
    metric: Annotated[
        list[str] | None,
        typer.Option(help="Metric to compare by; the leaderboard's order by default. Repeatable."),
    ] = None,
    entries: Annotated[Path, typer.Option(help="Folder of the entries of explainers given by name.")] = Path(
        "leaderboard/entries"
    ),
    plot: Annotated[
        Path | None, typer.Option(help="Picture to write: .png, .svg or .pdf; needs the extra 'plots'.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare explainers on the same policies and episodes: differences, intervals, tests, tie groups."""
    from dataclasses import asdict

    from xmarl_bench.cli import tables
    from xmarl_bench.compare.comparison import compare as run
    from xmarl_bench.compare.matching import blocks_of, read_named
    from xmarl_bench.compare.picture import check_picture, draw
    from xmarl_bench.metrics.table import ORDER

    if plot is not None:
        check_picture(plot)
    blocks = blocks_of(read_named(entry, entries, _bundled(entry)))
    comparisons = [run(blocks, each) for each in dict.fromkeys(metric or [ORDER])]
    if plot is not None:
        draw(comparisons, plot)
    if as_json:
        tables.print_json([asdict(each) for each in comparisons])
        return
    for comparison in comparisons:
        _print(comparison)
    if plot is not None:
        print(f"Picture in {plot}.")


def _bundled(names: list[str]) -> dict[str, list[Entry]]:
    """The entries of the names that are bundles. Raises InputError if one is invalid."""
    from xmarl_bench.errors import InputError
    from xmarl_bench.records.strict_json import printable
    from xmarl_bench.submission.archive import is_bundle
    from xmarl_bench.submission.checking import check

    found = {}
    for name in names:
        if is_bundle(Path(name)):
            checked = check(Path(name))
            if checked.findings:
                raise InputError(f"{printable(Path(name))} is invalid: run xmarl-bench validate on it.")
            found[name] = list(checked.entries.values())
    return found


def _print(comparison: Comparison) -> None:
    from xmarl_bench.cli.fitted_table import print_table
    from xmarl_bench.counted import counted

    n = len(comparison.states)
    print(f"{comparison.metric}, {comparison.better} is better, on {counted(n, 'policy')} and cells:")
    for states in comparison.states:
        print(f"  {states}")
    if comparison.trainings < n:
        print(
            f"They are of {counted(comparison.trainings, 'training')}: policies of one seed share its start, "
            f"and count as one, as a policy in several teams does."
        )
    print_table(
        [
            {
                "explainer": each.explainer,
                "mean": _number(each.mean.value),
                "95 %": _interval(each.mean),
                "IQM": _number(each.iqm),
                "units": each.mean.units,
                "tie group": each.tie_group,
            }
            for each in comparison.standings
        ],
        keep=("mean", "95 %", "tie group"),
    )
    best = comparison.standings[0].explainer
    few = len(comparison.standings) <= ALL_PAIRS
    shown = [pair for pair in comparison.pairs if few or pair.first == best]
    print_table(
        [
            {
                "pair": f"{pair.first} - {pair.second}",
                "difference": _number(pair.difference.value),
                "95 %": _interval(pair.difference),
                "P(better)": "-" if pair.improvement is None else f"{pair.improvement:.2f}",
                "p": "-" if pair.difference.p is None else f"{pair.difference.p:.2g}",
                "Holm": "-" if pair.p_holm is None else f"{pair.p_holm:.2g}",
            }
            for pair in shown
        ],
        keep=("difference", "95 %", "Holm"),
    )
    if len(shown) < len(comparison.pairs):
        print(f"Pairs with the first; --json has all {len(comparison.pairs)}, for which Holm corrects.")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _interval(difference: Difference) -> str:
    return "-" if difference.interval is None else "{:.4f} {:.4f}".format(*difference.interval)
