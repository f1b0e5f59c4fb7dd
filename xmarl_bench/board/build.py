"""Builds and checks the files derived from a folder's entries: JSON, CSV and the page.

Every derived file is first written under a temporary name, then all are renamed, the page `index.html` last.
Names of files under `pages/` contain a hash of their bytes, and files that no page refers to are removed. So
if a build is killed at any time, every file is complete, and each page finds the files that it was built
with. If it is killed while writing, the old board remains. If it is killed between two renames, some files
are new; `check` reports this, and the next build completes it.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from xmarl_bench.board.columns import COLUMNS
from xmarl_bench.board.details import Details, details_of
from xmarl_bench.board.page import PAGES, page_files
from xmarl_bench.board.tables import board_of
from xmarl_bench.entry.file import check_name, entry_files, read_entry
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.records.csv_cells import csv_cell
from xmarl_bench.records.files import locked, write_synced, writing

ANIMATIONS = "animations"
CARDS = "explainers.json"  # written by `xmarl-bench board explainers`
LOCK = ".board.lock"
STAGED = ".new"  # suffix of files that are written but not yet renamed
TABLES = ("leaderboard.csv", "leaderboard.json")
ROW_DEPTH = 6  # depth of a table's rows in the board's JSON


def build_board(folder: str | Path) -> Path:
    """Derive everything from FOLDER/entries/*.json; returns FOLDER/leaderboard.json.

    Raises InputError, before writing, if an entry is invalid, and if the disk is full or the folder cannot be
    written to. Builds of one folder wait for each other.
    """
    folder = Path(folder)
    with locked(folder, LOCK, wait=True):
        made = derived(folder)
        _publish(folder, {path: data for path, data in made.files.items() if _bytes(folder / path) != data})
        for path in _obsolete(folder, made):
            with writing(path):
                path.unlink()
    return folder / "leaderboard.json"


def check_board(folder: Path) -> list[str]:
    """A sentence for each stale file; empty if a build would change nothing.

    Checks the page only if it was built: the repository keeps the tables and the entries alone. Raises
    InputError if the folder does not exist or holds an invalid entry.
    """
    if not folder.is_dir():
        raise InputError(f"folder {folder} does not exist: give the folder of a leaderboard.")
    made = derived(folder)
    has_page = (folder / "index.html").exists()
    found = []
    for path, data in sorted(made.files.items()):
        if not has_page and path not in TABLES:
            continue
        present = _bytes(folder / path)
        if present != data:
            found.append(f"{folder / path} is {'missing' if present is None else 'stale'}.")
    return found + [f"{path} belongs to no entry." for path in _obsolete(folder, made)]


class Derived(NamedTuple):
    files: dict[str, bytes]  # by path in the folder, in the order of renaming
    animations: set[str]  # names of the entries' animations, existing or not


def derived(folder: Path) -> Derived:
    """Everything derived from the folder's entries. Raises InputError if an entry is invalid."""
    details: dict[str, Details] = {}
    known: set[str] = set()

    def read() -> Iterator[tuple[str, Entry]]:
        """Yield entries one at a time, because many are large; `details` keeps what the page shows."""
        for path in entry_files(folder / "entries").entries:
            entry, file = read_entry(path), f"entries/{path.name}"
            check_name(path, entry)
            details[file] = details_of(entry)
            known.add(animation_name(entry))
            yield file, entry

    board = board_of(read())
    present = {path.name for path in (folder / ANIMATIONS).glob("*.avif")}
    cards = folder / CARDS
    pages = page_files(board, details, present, json.loads(cards.read_bytes()) if cards.is_file() else {})
    files = {
        **{path: data for path, data in pages.items() if "/" in path},
        "leaderboard.csv": board_csv(board),
        "leaderboard.json": board_json(board),
        **{path: data for path, data in pages.items() if "/" not in path},
    }
    return Derived(files, known)


def animation_name(entry: Entry) -> str:
    return f"{entry.entry_id[:16]}.avif"


def board_json(board: Mapping[str, Any]) -> bytes:
    """JSON with sorted keys and one line for each row, so that a new entry changes few lines."""
    return (_json(board, ROW_DEPTH) + "\n").encode()


def board_csv(board: Mapping[str, Any]) -> bytes:
    """One line per row of every table: its names, its rank, and value, low and high of each metric."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["protocol", "episodes", "timesteps", "task", "n_agents", "max_cycles", "oracle", "policy",
         "trained_n_agents", "weights_sha256", "gate", "explainer", "control", "rank", "rank_low",
         "rank_high", "tie_group", "submitter", "variants_tried", "verification", "fresh_from",
         "public_less_fresh", "public_less_fresh_low", "public_less_fresh_high", "entry_id", "date", "paper",
         "code", "verified_by", "wall", "partial", "same_masks_as"]
        + [f"{metric}{part}" for metric in COLUMNS for part in ("", "_low", "_high")]
    )  # fmt: skip
    for table in board["tables"]:
        protocol = board["protocols"][table["protocol"]]
        for policy in table["policies"]:
            for row in policy["rows"]:
                cells = (
                    [protocol["id"], protocol["episodes"], protocol["timesteps"], table["task"],
                     table["n_agents"], table["max_cycles"], table["oracle"], policy["name"],
                     policy["trained_n_agents"], policy["weights_sha256"], policy["gate"],
                     row["explainer"], row["control"], row["rank"],
                     *(row["rank_interval"] or (None, None)), row["tie_group"], row["submitter"],
                     row["variants_tried"], row["verification"], *_fresh(row["fresh"]), row["entry_id"],
                     *(row[name] for name in ("date", "paper", "code", "verified_by", "wall", "partial")),
                     _names(row["same_masks_as"])]
                    + [number for metric in COLUMNS for number in _numbers(row["metrics"].get(metric))]
                )  # fmt: skip
                writer.writerow([csv_cell(each) for each in cells])
    return text.getvalue().encode()


def _names(rows: Sequence[Mapping[str, Any]]) -> str | None:
    return "; ".join(f"{each['explainer']} of {each['submitter'] or 'nobody'}" for each in rows) or None


def _fresh(fresh: Mapping[str, Any] | None) -> tuple[Any, ...]:
    """The value that seeds are derived from, and the difference that decides with its interval."""
    if fresh is None or fresh["decides"] is None:
        return None, None, None, None
    found = fresh["metrics"][fresh["decides"]]
    return fresh["value"], found["difference"], *(found["interval"] or (None, None))


def _numbers(summary: Mapping[str, Any] | None) -> tuple[float | None, ...]:
    if summary is None:
        return None, None, None
    return summary["value"], *(summary["interval"] or (None, None))


def _json(value: Any, depth: int, indent: str = "") -> str:
    if depth == 0 or not isinstance(value, dict | list) or not value:
        return json.dumps(value, sort_keys=True, allow_nan=False)
    inner = indent + " "
    if isinstance(value, dict):
        items = [f"{json.dumps(key)}: {_json(value[key], depth - 1, inner)}" for key in sorted(value)]
        return "{\n" + ",\n".join(inner + item for item in items) + f"\n{indent}}}"
    return "[\n" + ",\n".join(inner + _json(each, depth - 1, inner) for each in value) + f"\n{indent}]"


def _publish(folder: Path, files: Mapping[str, bytes]) -> None:
    staged: dict[Path, Path] = {}
    try:
        for path, data in files.items():
            target = folder / path
            staged[target] = target.with_name(f".{target.name}{STAGED}")
            with writing(target):
                target.parent.mkdir(exist_ok=True)
                write_synced(staged[target], data)
    except BaseException:
        for temporary in staged.values():
            with suppress(OSError):
                temporary.unlink()
        raise
    for target, temporary in staged.items():
        with writing(target):
            temporary.replace(target)


def _obsolete(folder: Path, made: Derived) -> list[Path]:
    """Leftovers of killed builds, pages without references, and animations without entries."""
    return sorted(
        [
            *folder.glob(f".*{STAGED}"),
            *(path for path in (folder / PAGES).glob("*") if f"{PAGES}/{path.name}" not in made.files),
            *(path for path in (folder / ANIMATIONS).glob("*") if path.name not in made.animations),
        ]
    )


def _bytes(path: Path) -> bytes | None:
    return path.read_bytes() if path.exists() else None
