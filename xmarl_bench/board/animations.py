"""A small animation for each entry: its first episode, with the explanation drawn.

They are named by the entry's id and never drawn twice. An entry has none where its policy or explainer is
not installed here; the page does without.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from xmarl_bench.animation import write_animation
from xmarl_bench.board.build import ANIMATIONS
from xmarl_bench.entry import Entry, read_entries
from xmarl_bench.errors import InputError
from xmarl_bench.policy import load_policy
from xmarl_bench.recording import record
from xmarl_bench.registry import find_explainer, find_policies
from xmarl_bench.request import Cell


def draw_missing(folder: Path) -> Iterator[str]:
    """Draw what FOLDER/animations/ lacks, remove what belongs to no entry; yields a line for each entry."""
    entries = [entry for _, entry in read_entries(folder / "entries")]
    wanted = {folder / ANIMATIONS / f"{entry.entry_id[:16]}.webp": entry for entry in entries}
    for path in sorted((folder / ANIMATIONS).glob("*")):
        if path not in wanted:
            path.unlink()
    for path, entry in wanted.items():
        if not path.exists():
            try:
                n_bytes = _draw(entry, path)
            except InputError as error:
                yield f"{entry.policy.name}, {entry.explainer.name}: no animation, for {error}"
            else:
                yield f"{path}: {entry.policy.name}, {entry.explainer.name}, {n_bytes / 1000:.0f} kB"


def _draw(entry: Entry, path: Path) -> int:
    policies = find_policies()
    if entry.policy.name not in policies:
        raise InputError(f"policy {entry.policy.name!r} is not installed.")
    policy, card = load_policy(policies[entry.policy.name])
    if card.weights_sha256 != entry.policy.weights_sha256:
        raise InputError(f"the installed policy {entry.policy.name!r} has other weights.")
    cell = entry.results[0]
    recording = record(
        Cell(cell.task, cell.n_agents).make(),
        entry.policy.name,
        policy,
        seed=entry.explainer.seed,
        max_cycles=cell.max_cycles,
    )
    return write_animation(recording, path, find_explainer(entry.explainer.name).explainer).n_bytes
