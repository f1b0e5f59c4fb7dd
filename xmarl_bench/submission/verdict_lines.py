"""What `verify` prints of a verdict."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from xmarl_bench.counted import counted
from xmarl_bench.entry.fresh import headline, worse_on_fresh
from xmarl_bench.entry.schema import Entry, FreshSeeds
from xmarl_bench.isolation.walls import Wall
from xmarl_bench.metrics.table import by_name
from xmarl_bench.records.strict_json import printable
from xmarl_bench.submission.verification import STATUS, Tier, Verdict

WALLS: dict[Wall, str] = {
    "bubblewrap": "bubblewrap",
    "landlock": "Landlock and seccomp",
    "process": "no wall",
}


def place(path: Path, file: str) -> str:
    """The entry's place: the file itself, or the folder or bundle that was given and the file in it."""
    return printable(path) if path.name == file else f"{printable(path)}: {printable(file)}"


def lines(path: Path, file: str, verdict: Verdict) -> Iterator[str]:
    """Lines to print: one per finding, or one that tells how the entry passed."""
    where = place(path, file)
    for finding in verdict.findings:
        yield f"{where}: {finding}"
    if verdict.fresh is not None:
        yield from (f"{where}: {each}" for each in _fresh_lines(verdict.entry, verdict.fresh))
    elif not verdict.findings:
        how = "bit for bit" if verdict.bitwise else "within the tolerance of another platform"
        again = (
            f", {counted(verdict.episodes, 'episode')} again" if verdict.tier is not Tier.recompute else ""
        )
        behind = "" if verdict.wall is None else f", third-party code behind {WALLS[verdict.wall]}"
        yield (
            f"{where}: {STATUS[verdict.tier]}{again}{behind}, {how}, "
            f"largest difference {verdict.max_abs_diff}."
        )


def _fresh_lines(entry: Entry, fresh: FreshSeeds) -> Iterator[str]:
    """For each cell the metric that decides, and whether the explainer does worse."""
    for cell, compared in zip(entry.results, fresh.cells, strict=True):
        episodes = counted(fresh.episodes, "fresh episode")
        where = f"{cell.task}, {counted(cell.n_agents, 'agent')}: {episodes} from {fresh.value}"
        decides = headline(compared)
        if decides is None:
            yield f"{where}: no metric to compare."
            continue
        name, found = decides
        interval = "" if found.interval is None else " [{:.3f}, {:.3f}]".format(*found.interval)
        yield f"{where}: {by_name()[name].title}, public less fresh {found.difference:.3f}{interval}."
        worse = worse_on_fresh(compared)
        if worse is not None:
            yield worse
