"""Writes the measured part of docs/scaling.md: what scoring costs, from the `cost` of the entries.

    .venv/bin/python docs/make_scaling.py

Run it after entries were added or scored again; tests/docs/test_scaling_page.py fails until then.
"""

from __future__ import annotations

import json
from collections import defaultdict
from functools import cache
from pathlib import Path
from statistics import mean, median
from typing import Any, NamedTuple

from xmarl_bench.entry.file import SHARED, entry_files
from xmarl_bench.entry.schema import Cost
from xmarl_bench.records.markdown import markdown_table, rewrite, with_part

HERE = Path(__file__).parent
ENTRIES = HERE.parent / "leaderboard" / "entries"
POLICIES = 10_000
CORES = 64
PRICE = 0.05  # US dollars for one rented core for one hour: an assumption, not a measurement


class Measured(NamedTuple):
    """What an entry says of its costs."""

    explainer: str
    policy: str
    n_agents: int
    timesteps: int | None  # of an episode; None: all
    cost: Cost
    cpu: str

    @property
    def label(self) -> str:
        some = "" if self.timesteps is None else f", {self.timesteps} timesteps an episode"
        return f"`{self.explainer}`{some}"


def section(entries: list[Measured]) -> str:
    """The table of seconds per (policy, explainer), and the total for `POLICIES`."""
    by_explainer: dict[str, list[Measured]] = defaultdict(list)
    for entry in entries:
        by_explainer[entry.label].append(entry)
    sizes = sorted({entry.n_agents for entry in entries})
    shared = _shared(entries)
    rows = [_row("oracle and controls, once per policy", sizes, shared)]
    total = mean([seconds for _, seconds in shared])
    summands = [f"{total:.1f}"]
    for label, its_entries in sorted(by_explainer.items()):
        masks = [(entry.n_agents, entry.cost.explain_seconds) for entry in its_entries]
        rows.append(_row(f"{label}: masks", sizes, masks))
        played = [
            (entry.n_agents, entry.cost.behaviour_seconds)
            for entry in its_entries
            if entry.cost.behaviour_seconds
        ]
        if played:
            rows.append(_row(f"{label}: playing on them", sizes, played))
        for part in (masks, played):
            if part:
                summands.append(f"{mean(seconds for _, seconds in part):.1f}")
                total += mean(seconds for _, seconds in part)
    hours, n_ours = total * POLICIES / 3600, len(shared)
    timesteps = [entry.cost.explained_timesteps for entry in entries]
    cpus = ", ".join(sorted({entry.cpu for entry in entries}))
    some = f"{min(timesteps)} to {max(timesteps)}"
    lines = [
        markdown_table(("seconds on one core", *(f"{n} agents" for n in sizes), "policies"), rows),
        f"Means over the policies of {len(entries)} entries, of {some} timesteps, on {cpus}.",
        "",
        f"A policy takes the sum of the means, {' + '.join(summands)} = {total:.0f} s.",
        f"The leaderboard's {n_ours} policies take {n_ours} x {total:.0f} s / 3600 = "
        f"{n_ours * total / 3600:.1f} core-hours.",
        f"{POLICIES:,} policies take {POLICIES:,} x {total:.0f} s / 3600 = {hours:,.0f} core-hours:",
        f"{hours / CORES:,.1f} hours on {CORES} cores, and {hours:,.0f} x {PRICE:.2f} = {hours * PRICE:,.0f} "
        f"US dollars if a core costs {PRICE:.2f} an hour (an assumption: insert your price).",
        "",
    ]
    return "\n".join(lines)


def _shared(entries: list[Measured]) -> list[tuple[int, float]]:
    """(team size, seconds) of each policy that is explained on all timesteps."""
    seconds: dict[tuple[str, int], list[float]] = defaultdict(list)
    for entry in entries:
        if entry.timesteps is None:
            seconds[entry.policy, entry.n_agents].append(entry.cost.shared_seconds)
    return [(n_agents, median(each)) for (_, n_agents), each in seconds.items()]


def _row(what: str, sizes: list[int], seconds: list[tuple[int, float]]) -> list[str]:
    cells = [what]
    for size in sizes:
        those = [each for n_agents, each in seconds if n_agents == size]
        cells.append(f"{mean(those):.1f}" if those else "-")
    return [*cells, str(len(seconds))]


def page(text: str, entries: list[Measured]) -> str:
    """`text` of the page with its measured part replaced."""
    return with_part(text, "measured", section(entries))


def measured() -> list[Measured]:
    """Entries of policies in teams of the size that they were trained for.

    Does not check them: that takes ten times as long, and a build of the board does it.
    """
    found = []
    for path in entry_files(ENTRIES).entries:
        own = json.loads(path.read_bytes())
        shared = _shared_part(own[SHARED])
        policy, protocol = shared["policy"], shared["protocol"]
        if {cell["n_agents"] for cell in shared["results"]} == {policy["n_agents"]}:
            explainer, cpu = own["explainer"]["name"], own["provenance"]["cpu"]
            name, n_agents, timesteps = policy["name"], policy["n_agents"], protocol["timesteps"]
            cost = Cost.model_validate(own["cost"])
            found.append(Measured(explainer, name, n_agents, timesteps, cost, cpu))
    return found


@cache
def _shared_part(digest: str) -> dict[str, Any]:
    """What entries of a policy share."""
    part: dict[str, Any] = json.loads((ENTRIES / SHARED / f"{digest}.json").read_bytes())
    return part


if __name__ == "__main__":
    rewrite(HERE / "scaling.md", lambda text: page(text, measured()))
