"""A small animation for each entry: its first episode, with the explanation drawn.

Files are named by the entry's id and never drawn twice, so an interrupted run continues where it stopped. An
entry whose policy or explainer is not installed here gets no animation, and the page shows none.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from xmarl_bench.board.build import ANIMATIONS, animation_name
from xmarl_bench.entry.file import entry_files, read_entry
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.plugins.names import find_policy
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import load_policy
from xmarl_bench.render.animation import write_animation
from xmarl_bench.render.recording import Recording, record
from xmarl_bench.rollout.cell import Cell

Played = dict[tuple[object, ...], Recording]


def draw_missing(folder: Path) -> Iterator[str]:
    """Draw the animations missing in FOLDER/animations/. Yields a line for each, or why there is none."""
    played: Played = {}  # the last policy's episode, which its explainers share: files are sorted by policy
    for file in entry_files(folder / "entries").entries:
        entry = read_entry(file)
        path = folder / ANIMATIONS / animation_name(entry)
        if path.exists():
            continue
        try:
            n_bytes = _draw(entry, path, played)
        except InputError as error:
            yield f"{entry.policy.name}, {entry.explainer.name}: no animation: {error}"
        else:
            yield f"{path}: {entry.policy.name}, {entry.explainer.name}, {n_bytes / 1000:.0f} kB"


def _draw(entry: Entry, path: Path, played: Played) -> int:
    """Bytes written. Raises InputError if the policy or explainer is missing, or the policy has changed."""
    explainer = find_explainer(entry.explainer.name)
    cell, seed = entry.results[0], entry.explainer.seed
    key = (entry.policy.weights_sha256, cell.task, cell.n_agents, cell.max_cycles, seed)
    if key not in played:
        played.clear()
        policy, card = load_policy(find_policy(entry.policy.name))
        if card.weights_sha256 != entry.policy.weights_sha256:
            raise InputError(
                f"the installed policy {entry.policy.name!r} has other weights: install the one scored."
            )
        task = Cell(cell.task, cell.n_agents).make()
        played[key] = record(task, card.name, policy, seed=seed, max_cycles=cell.max_cycles)
    return write_animation(played[key], path, explainer).n_bytes
