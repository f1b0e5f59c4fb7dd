"""Packs a submission: entries, their policies, their rows, a licence and a manifest, as one zip or folder."""

from __future__ import annotations

import io
import secrets
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from xmarl_bench.entry.file import entry_text
from xmarl_bench.entry.schema import Entry, Verification, entry_id
from xmarl_bench.errors import InputError
from xmarl_bench.origin.installed import harness_version
from xmarl_bench.policy.untrusted import CARD, WEIGHTS, read_member
from xmarl_bench.records.files import pretty_json, write_atomically
from xmarl_bench.records.strict_json import fields_named
from xmarl_bench.submission.archive import MANIFEST
from xmarl_bench.submission.manifest import Manifest, file_records, rows_csv

EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time in a zip; fixed, so that equal files give equal bytes


def as_submitted(
    entry: Entry,
    submitter: str,
    code: str | None,
    variants_tried: int | None = None,
    paper: str | None = None,
) -> Entry:
    """The entry with submitter, links and variants tried filled in, which are part of its id."""
    links = {name: link for name, link in (("code", code), ("paper", paper)) if link is not None}
    explainer = entry.explainer.model_copy(update=links)
    changed = entry.model_copy(
        update={
            "submitter": submitter,
            "explainer": explainer,
            "variants_tried": entry.variants_tried if variants_tried is None else variants_tried,
            "verification": Verification(),
        }
    )
    return changed.model_copy(update={"entry_id": entry_id(changed)})


def bundle_files(
    entries: Sequence[Entry],
    policies: Mapping[str, Path],
    *,
    submitter: str,
    licence: bytes,
    contact: str | None = None,
) -> dict[str, bytes]:
    """Every file of the bundle, by name. policies: the bundle of each policy of the entries.

    Raises InputError if two entries are of the same score, a policy cannot be read, or the manifest could not
    hold a value.
    """
    files = {"LICENSE": licence}
    for entry in entries:
        name = f"entries/{entry.file_name}"
        if name in files:
            raise InputError(f"two entries have the file name {entry.file_name}: give each score once.")
        files[name] = entry_text(entry)
        files[f"rows/{entry.file_name.removesuffix('.json')}.csv"] = rows_csv(entry)
    for name, folder in policies.items():
        for file in (CARD, WEIGHTS):
            files[f"policies/{name}/{file}"] = read_member(folder, file)
    with fields_named("the bundle's"):
        manifest = Manifest(
            submitter=submitter,
            contact=contact,
            harness_version=harness_version(),
            files=file_records(files),
        )
    return {MANIFEST: pretty_json(manifest.model_dump(mode="json")), **files}


def write_bundle(path: Path, files: Mapping[str, bytes]) -> None:
    """Write a zip if `path` ends with .zip, else a folder: atomically, beside `path`, then renamed.

    Raises InputError if `path` exists.
    """
    if path.exists():
        raise InputError(f"{path} already exists: give another name, or remove it first.")
    if path.suffix == ".zip":
        write_atomically(path, _zipped(files))
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        folder.mkdir()
        for name, data in files.items():
            write_atomically(folder / name, data)
        folder.rename(path)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _zipped(files: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            member = zipfile.ZipInfo(name, EPOCH)
            member.compress_type, member.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(member, files[name])
    return buffer.getvalue()
