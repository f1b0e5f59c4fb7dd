"""Checks that an entry or a bundle of entries is valid for the leaderboard, without running anything of it.

Submitters and maintainers use the same checks: those of `xmarl-bench submit`, `validate` and `verify`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from xmarl_bench.counted import counted
from xmarl_bench.entry.file import entry_files, folder_of_entries, parse_entry
from xmarl_bench.entry.partial import partial_reason
from xmarl_bench.entry.schema import Entry, PolicyRecord, Verification
from xmarl_bench.errors import InputError
from xmarl_bench.policy.bundle import Weights, build, parse_weights
from xmarl_bench.policy.card import PolicyCard, parse_card
from xmarl_bench.policy.untrusted import CARD, WEIGHTS
from xmarl_bench.records.strict_json import MAX_BYTES, first_error, parse_json, printable, shown
from xmarl_bench.submission.archive import MANIFEST, is_bundle, kind_of, read_files
from xmarl_bench.submission.consistency import entry_findings
from xmarl_bench.submission.coverage import coverage_remarks
from xmarl_bench.submission.manifest import Manifest, file_records, rows_csv
from xmarl_bench.submission.recompute import Difference, recomputed
from xmarl_bench.submission.rounding import CLOSE
from xmarl_bench.submission.tolerance import agrees

if TYPE_CHECKING:
    from xmarl_bench.policy import Policy

MAX_FINDINGS = 20  # per file


@dataclass
class Checked:
    """The content of a path, and what is wrong with it: sentences that begin with the place in the path."""

    path: Path
    entries: dict[str, Entry] = field(default_factory=dict)  # by file name
    policies: dict[str, tuple[bytes, bytes]] = field(default_factory=dict)  # by name: card, weights
    recomputed: dict[str, list[Difference]] = field(default_factory=dict)  # by file name, of valid entries
    findings: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)  # sentences about what is valid but not as usual

    @property
    def is_bundle(self) -> bool:
        return is_bundle(self.path)

    @property
    def folder(self) -> Path:
        """The folder of the entries, unless it is a bundle."""
        return folder_of_entries(self.path) if self.path.is_dir() else self.path.parent

    def told(self, file: str, sentence: str) -> str:
        """The sentence, after the file's name unless the path is that file."""
        return sentence if self.path.name == file else f"{printable(file)}: {sentence}"

    def part(self, file: str) -> Checked:
        """The part that a worker needs to verify one of the entries."""
        entry = self.entries[file]
        name = entry.policy.name
        policies = {name: self.policies[name]} if name in self.policies else {}
        return replace(
            self, entries={file: entry}, policies=policies, recomputed={file: self.recomputed[file]}
        )

    def read_policy(self, name: str) -> tuple[PolicyCard, Weights]:
        """A policy of the bundle, as data. Raises InputError if it is invalid."""
        card_data, weights_data = self.policies[name]
        card = parse_card(card_data, CARD)
        return card, parse_weights(weights_data, card, WEIGHTS)

    def load_policy(self, name: str) -> tuple[Policy, PolicyCard]:
        """Build a policy of the bundle, which imports torch. Raises InputError as `read_policy` does."""
        card, weights = self.read_policy(name)
        return build(card, weights), card


def check(path: Path) -> Checked:
    """Check an entry file, a bundle (zip, or folder with a manifest) or a folder of entries.

    Raises InputError if the path cannot be read. Invalid content gives `findings`.
    """
    checked = Checked(path)
    try:
        if checked.is_bundle:
            _check_bundle(checked)
        elif path.is_dir():
            names, strays = entry_files(folder_of_entries(path))
            checked.remarks += [
                f"{printable(each.name)} is not an entry, and was left out." for each in strays
            ]
            if not names:
                raise InputError(
                    f"{printable(path)} holds no entries (*.json) and no {MANIFEST}: give a folder of "
                    f"entries, or a bundle."
                )
            for name in names:
                entry = _check_entry(checked, name.name, _read(name), name.parent)
                if entry is not None:
                    _add(checked, name.name, _name_findings(entry, name.name, checked))
        else:
            _check_entry(checked, path.name, _read(path), path.parent)
    except OSError as error:
        raise InputError(
            f"{printable(path)} cannot be read ({error.strerror}): give an entry, a bundle or a folder of "
            f"entries."
        ) from None
    for file, entry in checked.entries.items():
        for cell in entry.results:
            why = partial_reason(entry.protocol, cell)
            if why is not None:
                checked.remarks.append(checked.told(file, f"a partial score ({why}): valid, but not ranked."))
    if path.is_dir() or checked.is_bundle:
        checked.remarks += coverage_remarks(checked.entries.values())
    if not checked.findings:  # the most expensive checks come last, and need valid rows
        for file, entry in checked.entries.items():
            found = checked.recomputed[file] = list(recomputed(entry))
            _add(checked, file, (each.sentence("rows give") for each in found if not agrees(each, CLOSE)))
        for policy in checked.policies:
            _add(checked, f"policies/{policy}", _policy_findings(checked, policy))
    return checked


def _read(path: Path) -> bytes:
    if not path.is_file():
        raise InputError(f"{printable(path)} does not exist: give an entry, a bundle or a folder of entries.")
    with path.open("rb") as file:
        return file.read(MAX_BYTES + 1)


def _add(checked: Checked, file: str, findings: Iterator[str]) -> None:
    listed = list(findings)
    checked.findings += [checked.told(file, each) for each in listed[:MAX_FINDINGS]]
    if len(listed) > MAX_FINDINGS:
        more = counted(len(listed) - MAX_FINDINGS, "more finding")
        checked.findings.append(checked.told(file, f"and {more}."))


def _check_entry(checked: Checked, file: str, data: bytes, folder: Path | None = None) -> Entry | None:
    """folder: where the entry's shared part may be."""
    try:
        entry = parse_entry(data, folder)
    except ValueError as error:
        checked.findings.append(checked.told(file, f"it {error}."))
        return None
    checked.entries[file] = entry
    _add(checked, file, entry_findings(entry))
    return entry


def _check_bundle(checked: Checked) -> None:
    try:
        files = read_files(checked.path)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        checked.findings.append(f"{printable(checked.path.name)}: {error}")
        return
    _add(checked, MANIFEST, _manifest_findings(files))
    if "LICENSE" not in files:
        checked.findings.append("LICENSE: it is missing: add the licence of the bundle.")
    for name, card in files.items():
        if kind_of(name) == "card":
            weights = files.get(name.replace(CARD, WEIGHTS))
            if weights is not None:
                checked.policies[name.split("/")[1]] = card, weights
    for name, data in files.items():
        if kind_of(name) == "entry":
            entry = _check_entry(checked, name, data)
            if entry is not None:
                _add(checked, name, _submission_findings(entry, name, files, checked))
    if not any(kind_of(name) == "entry" for name in files):
        checked.findings.append("entries/: it holds no entry: add one.")
    used = {entry.policy.name for entry in checked.entries.values()}
    rows = {name for name in files if kind_of(name) == "rows"}
    expected_rows = {name.replace("entries/", "rows/", 1)[: -len("json")] + "csv" for name in checked.entries}
    for name in sorted(files):
        if kind_of(name) in ("card", "weights") and name.split("/")[1] not in used:
            checked.findings.append(f"{name}: no entry is of this policy: remove it.")
    for name in sorted(rows - expected_rows):
        checked.findings.append(f"{name}: it belongs to no entry: remove it.")


def _manifest_findings(files: dict[str, bytes]) -> Iterator[str]:
    data = files.get(MANIFEST)
    if data is None:
        yield "it is missing: pack the bundle with `xmarl-bench submit`."
        return
    try:
        parse_json(data)
        manifest = Manifest.model_validate_json(data)
    except ValidationError as error:
        problem, where = first_error(error)
        yield f"{problem} at {shown(where, 120)}."
        return
    except ValueError as error:
        yield f"it {error}."
        return
    found = file_records({name: content for name, content in files.items() if name != MANIFEST})
    for name in sorted(found.keys() | manifest.files.keys()):
        if name not in manifest.files:
            yield f"it does not list {name}."
        elif name not in found:
            yield f"it lists {shown(name, 300)}, which the bundle does not hold."
        elif manifest.files[name] != found[name]:
            yield f"its size or sha256 of {name} differs from the file's."


def _policy_findings(checked: Checked, name: str) -> Iterator[str]:
    """Findings if the policy is invalid, or not the one of the entries."""
    try:
        card, _ = checked.read_policy(name)
    except InputError as error:
        yield str(error)
        return
    for file, entry in checked.entries.items():
        if entry.policy.name == name:  # the folder's name: a card may hold another
            for key in PolicyRecord.model_fields:
                if hasattr(card, key) and getattr(card, key) != getattr(entry.policy, key):
                    yield f"its {key} disagrees with policy.{key} of {file}."


def _name_findings(entry: Entry, name: str, checked: Checked) -> Iterator[str]:
    if name.rpartition("/")[2] != entry.file_name:
        yield f"its name should be {entry.file_name}."
    for file, other in checked.entries.items():
        if file != name and other.entry_id == entry.entry_id:
            yield f"it is the same entry as {shown(file)}: give each entry once."


def _submission_findings(entry: Entry, name: str, files: dict[str, bytes], checked: Checked) -> Iterator[str]:
    yield from _name_findings(entry, name, checked)
    if entry.verification != Verification():
        yield "verification is written by the maintainers: leave it out."
    rows = files.get(f"rows/{entry.file_name.removesuffix('.json')}.csv")
    if rows is None:
        yield "its rows/*.csv is missing."
    elif rows != rows_csv(entry):
        yield "its rows/*.csv disagrees with the entry."
    if entry.policy.name not in checked.policies:
        yield f"its policy is missing from policies/{entry.policy.name}/."
