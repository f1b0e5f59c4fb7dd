"""Matches entries that can be compared by episode: those of the same policies, cells, protocol and seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from xmarl_bench.counted import counted
from xmarl_bench.entry.file import folder_of_entries, read_entries, read_entry
from xmarl_bench.entry.schema import CellResult, Entry
from xmarl_bench.entry.training import training_of
from xmarl_bench.errors import InputError, unknown
from xmarl_bench.records.files import canonical_json


class Block(NamedTuple):
    """An explainer's results on one policy in one cell."""

    cell: CellResult
    training: str  # of the policy, see `training_of`


Blocks = dict[str, dict[str, Block]]  # explainer -> states (the same for all explainers) -> its results


def read_named(
    names: Sequence[str], folder: Path, bundled: Mapping[str, Sequence[Entry]] | None = None
) -> list[Entry]:
    """Read entries by name: a file, a folder (of entries, or as `score` writes it), or an explainer.

    An explainer with entries in `folder` comes before a file or folder of that name in the working directory.
    bundled: the entries of names that are bundles. Files are used as they are; entries of other names are
    restricted to the states that all explainers share. Raises InputError for a name without entries.
    """

    @cache
    def by_explainer() -> dict[str, list[Entry]]:
        found: dict[str, list[Entry]] = {}
        for _, entry in read_entries(folder_of_entries(folder)):
            found.setdefault(entry.explainer.name, []).append(entry)
        return found

    found: list[Entry] = []
    files = True
    for name in names:
        path = Path(name)
        is_path = len(path.parts) > 1 or path.suffix == ".json"
        entries: Sequence[Entry]
        if bundled and name in bundled:
            entries, files = bundled[name], False
        elif not is_path and name in by_explainer():
            entries, files = by_explainer()[name], False
        elif path.is_dir():
            entries, files = [entry for _, entry in read_entries(folder_of_entries(path))], False
            if not entries:
                raise InputError(f"{name} holds no entries: give a folder with files of entries.")
        elif is_path or path.is_file():
            entries = [read_entry(path)]
        elif not by_explainer():
            raise InputError(
                f"{folder} holds no entries, so {name!r} names no explainer there: give another folder "
                f"(--entries), or files or folders of entries."
            )
        else:
            hint = "or give a file or folder of entries"
            raise unknown(f"explainer with entries in {folder}", name, sorted(by_explainer()), hint)
        found += [entry for entry in entries if entry not in found]
    return found if files else shared_states(found)


def shared_states(entries: Sequence[Entry]) -> list[Entry]:
    """The entries on states that all explainers share.

    If a policy and cell have several such protocols, as when slow explainers are scored on fewer states,
    those of the protocol with most timesteps. Raises InputError if no states are shared, or if several
    protocols have as many timesteps, as of two seeds.
    """
    explainers = {entry.explainer.name for entry in entries}
    by_states: dict[tuple[bytes, ...], list[Entry]] = {}
    for entry in entries:
        by_states.setdefault(tuple(_states(entry, cell) for cell in entry.results), []).append(entry)
    shared: dict[tuple[str, tuple[tuple[str, int], ...]], list[list[Entry]]] = {}
    for same in by_states.values():
        if {entry.explainer.name for entry in same} != explainers:
            continue
        where = same[0].policy.name, tuple((cell.task, cell.n_agents) for cell in same[0].results)
        shared.setdefault(where, []).append(same)
    if not shared:
        raise InputError(
            f"{', '.join(sorted(explainers))} have no states in common: score them on the same policies, "
            f"episodes and timesteps."
        )
    found = []
    for (policy, _), candidates in shared.items():
        timesteps = [same[0].cost.explained_timesteps for same in candidates]
        if timesteps.count(max(timesteps)) > 1:
            raise InputError(
                f"all of these explainers were scored on {policy} more than once, on different states: "
                f"compare one folder of results, or entries of one seed."
            )
        found += candidates[timesteps.index(max(timesteps))]
    return found


def blocks_of(entries: Sequence[Entry]) -> Blocks:
    """The results of each explainer, by states. Raises InputError if the explainers have different states.

    Entries are paired by episode, so all explainers need entries on the same policies, cells, protocols and
    seeds.
    """
    blocks: Blocks = {}
    keys: dict[str, bytes] = {}
    for entry in entries:
        for cell in entry.results:
            name = f"{entry.policy.name}, {cell.task}, {counted(cell.n_agents, 'agent')}"
            key = _states(entry, cell)
            if keys.setdefault(name, key) != key:
                raise InputError(
                    f"entries on {name}, of {entry.explainer.name!r} and others, were scored on different "
                    f"states or by different protocols: compare entries of one protocol and the same "
                    f"episodes."
                )
            cells = blocks.setdefault(entry.explainer.name, {})
            if name in cells:
                raise InputError(f"there are two entries of {named(entry.explainer.name, name)}: give one.")
            cells[name] = Block(cell, training_of(entry.policy))
    if len(blocks) < 2:
        raise InputError(
            f"a comparison needs two explainers, got {', '.join(blocks) or 'none'}: give entries of two."
        )
    everywhere = sorted(keys)
    for explainer, cells in blocks.items():
        missing = [name for name in everywhere if name not in cells]
        if missing:
            raise InputError(
                f"explainer {explainer!r} has no entry on {missing[0]}, but others have: score it there, or "
                f"leave these entries out."
            )
    return {explainer: {name: cells[name] for name in everywhere} for explainer, cells in blocks.items()}


def named(explainer: str, states: str) -> str:
    return f"{explainer!r} on {states}"


def _states(entry: Entry, cell: CellResult) -> bytes:
    """The part that two entries must share so that their episodes are pairs."""
    return canonical_json(
        [
            entry.policy.weights_sha256,
            entry.protocol.model_dump(mode="json"),
            cell.task,
            cell.n_agents,
            cell.max_cycles,
            [row.seed for row in cell.episodes],
        ]
    )
