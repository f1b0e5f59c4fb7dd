"""The entries of a folder that answer the requests of a study, so that nothing is scored."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from xmarl_bench.entry.file import folder_of_entries, read_entries
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import Failed

Key = tuple[object, ...]  # with name and weights: two checkpoints of unlike names may have the same weights


def existing_entries(requests: Sequence[Request], folder: Path) -> list[Entry | Failed]:
    """For each request, the entry of its policy, explainer, cells and states; Failed if there is none.

    folder: of entries, or one that `score` wrote. Raises InputError if it does not exist, if two entries
    answer one request, or if none answers any.
    """
    if not folder.is_dir():
        raise InputError(f"folder {folder} does not exist: give one of entries.")
    known: dict[Key, tuple[Path, Entry]] = {}
    keys = [_key_of_request(request) for request in requests]
    wanted = set(keys)
    for path, entry in read_entries(folder_of_entries(folder)):
        key = _key_of_entry(entry)
        if key not in wanted:
            continue
        if key in known:
            raise InputError(
                f"{known[key][0]} and {path} have the same policy, explainer and states: remove one of them."
            )
        known[key] = path, entry
    if not known:
        raise InputError(f"no entry in {folder} is of this study: score there first, or leave --entries out.")
    missing = f"has no entry with these states in {folder}: score it there first, or leave --entries out."
    return [
        known[key][1] if key in known else Failed(request, missing)
        for request, key in zip(requests, keys, strict=True)
    ]


def _key_of_request(request: Request) -> Key:
    sampling = request.sampling
    cells = tuple(
        (cell.task, cell.n_agents, sampling.max_cycles or cell.make().default_max_cycles)
        for cell in request.cells
    )
    return (
        request.card.name,
        request.card.weights_sha256,
        request.explainer.name,
        cells,
        tuple(sampling.seeds),
        sampling.timesteps,
    )


def _key_of_entry(entry: Entry) -> Key:
    protocol = entry.protocol
    cells = tuple((cell.task, cell.n_agents, cell.max_cycles) for cell in entry.results)
    return (
        entry.policy.name,
        entry.policy.weights_sha256,
        entry.explainer.name,
        cells,
        protocol.seeds,
        protocol.timesteps,
    )
