"""Writes the measured part of docs/scaling.md: what scoring costs, from the `cost` of the entries.

    .venv/bin/python docs/make_scaling.py

Run it after entries were added or scored again; tests/docs/test_scaling_page.py fails until then.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from statistics import mean, median

from xmarl_bench.entry.file import read_entries
from xmarl_bench.entry.schema import Entry
from xmarl_bench.records.markdown import markdown_table, rewrite, with_part

HERE = Path(__file__).parent
ENTRIES = HERE.parent / "leaderboard" / "entries"
POLICIES = 10_000
CORES = 64
PRICE = 0.05  # US dollars for one rented core for one hour: an assumption, not a measurement


def section(entries: list[Entry]) -> str:
    """The table of seconds per (policy, explainer), and the total for `POLICIES`."""
    by_explainer: dict[str, list[Entry]] = defaultdict(list)
    for entry in entries:
        by_explainer[_label(entry)].append(entry)
    sizes = sorted({entry.policy.n_agents for entry in entries})
    shared = _shared(entries)
    rows = [_row("oracle and controls, once per policy", sizes, shared)]
    total = mean([seconds for _, seconds in shared])
    summands = [f"{total:.1f}"]
    for label, its_entries in sorted(by_explainer.items()):
        masks = [(entry.policy.n_agents, _masks(entry)) for entry in its_entries]
        rows.append(_row(f"{label}: masks", sizes, masks))
        played = [
            (entry.policy.n_agents, entry.cost.behaviour_seconds)
            for entry in its_entries
            if entry.cost.behaviour_seconds
        ]
        if played:
            rows.append(_row(f"{label}: playing on them", sizes, played))
        for part in (masks, played):
            if part:
                summands.append(f"{mean(seconds for _, seconds in part):.1f}")
                total += mean(seconds for _, seconds in part)
    hours = total * POLICIES / 3600
    timesteps = [entry.cost.explained_timesteps for entry in entries]
    cpus = ", ".join(sorted({entry.provenance.cpu for entry in entries}))
    some = f"{min(timesteps)} to {max(timesteps)}"
    lines = [
        markdown_table(("seconds on one core", *(f"{n} agents" for n in sizes), "policies"), rows),
        f"Means over the policies of {len(entries)} entries, of {some} timesteps, on {cpus}.",
        "",
        f"A policy takes the sum of the means, {' + '.join(summands)} = {total:.0f} s.",
        f"{POLICIES:,} policies take {POLICIES:,} x {total:.0f} s / 3600 = {hours:,.0f} core-hours:",
        f"{hours / CORES:,.1f} hours on {CORES} cores, and {hours:,.0f} x {PRICE:.2f} = {hours * PRICE:,.0f} "
        f"US dollars if a core costs {PRICE:.2f} an hour (an assumption: insert your price).",
        "",
    ]
    return "\n".join(lines)


def _label(entry: Entry) -> str:
    timesteps = entry.protocol.timesteps
    return f"`{entry.explainer.name}`" + ("" if timesteps is None else f", {timesteps} timesteps an episode")


def _masks(entry: Entry) -> float:
    return entry.cost.explain_seconds_per_timestep * entry.cost.explained_timesteps


def _shared(entries: list[Entry]) -> list[tuple[int, float]]:
    """(team size, seconds) of each policy that is explained on all timesteps."""
    seconds: dict[tuple[str, int], list[float]] = defaultdict(list)
    for entry in entries:
        if entry.protocol.timesteps is None:
            each = entry.cost.shared_seconds_per_timestep * entry.cost.explained_timesteps
            seconds[entry.policy.name, entry.policy.n_agents].append(each)
    return [(n_agents, median(each)) for (_, n_agents), each in seconds.items()]


def _row(what: str, sizes: list[int], seconds: list[tuple[int, float]]) -> list[str]:
    cells = [what]
    for size in sizes:
        those = [each for n_agents, each in seconds if n_agents == size]
        cells.append(f"{mean(those):.1f}" if those else "-")
    return [*cells, str(len(seconds))]


def page(text: str, entries: list[Entry]) -> str:
    """`text` of the page with its measured part replaced."""
    return with_part(text, "measured", section(entries))


def measured() -> list[Entry]:
    """Entries of policies in teams of the size that they were trained for."""
    entries = [entry for _, entry in read_entries(ENTRIES)]
    return [each for each in entries if {cell.n_agents for cell in each.results} == {each.policy.n_agents}]


if __name__ == "__main__":
    rewrite(HERE / "scaling.md", lambda text: page(text, measured()))
