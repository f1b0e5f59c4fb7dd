"""Third-party archives: names are compared with a closed list, sizes counted, and nothing is unpacked."""

from __future__ import annotations

import io
import os
import stat
import struct
import time
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from tests.bench.submission.conftest import Pack
from tests.conftest import RunCli
from xmarl_bench.errors import InputError
from xmarl_bench.submission.archive import KINDS, MAX_FILES, kind_of, read_files
from xmarl_bench.submission.checking import check

Make = Callable[[zipfile.ZipFile], object]


def zipped(path: Path, make: Make) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        make(archive)
    return path


def link(archive: zipfile.ZipFile) -> None:
    member = zipfile.ZipInfo("policies/x/policy.json")
    member.external_attr = (stat.S_IFLNK | 0o777) << 16
    archive.writestr(member, "/etc/passwd")


def zeros(n_bytes: int) -> Make:
    """A member of zeros, compressed to about a thousandth of its size."""

    def make(archive: zipfile.ZipFile) -> None:
        with archive.open("policies/x/policy.safetensors", "w", force_zip64=True) as file:
            for _ in range(n_bytes // 2**20):
                file.write(bytes(2**20))

    return make


def many(size: int) -> Make:
    def make(archive: zipfile.ZipFile) -> None:
        for k in range(4):
            with archive.open(f"policies/p{k}/policy.safetensors", "w") as file:
                file.write(bytes(size))

    return make


def twice(archive: zipfile.ZipFile) -> None:
    archive.writestr("LICENSE", "one")
    with pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("LICENSE", "other")


def bzip2(archive: zipfile.ZipFile) -> None:
    archive.writestr("LICENSE", "x" * 100, compress_type=zipfile.ZIP_BZIP2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda archive: archive.writestr("../evil.json", "{}"), "not a file of a bundle"),
        (lambda archive: archive.writestr("/etc/cron.d/evil", "{}"), "not a file of a bundle"),
        (lambda archive: archive.writestr("entries/../../evil.json", "{}"), "not a file of a bundle"),
        (lambda archive: archive.writestr("entries\\evil.json", "{}"), "not a file of a bundle"),
        (lambda archive: archive.writestr("entries/a.json\n", "{}"), "not a file of a bundle"),
        (lambda archive: archive.writestr("Entries/a.json", "{}"), "not a file of a bundle"),
        (lambda archive: archive.writestr("policies/x/policy.pkl", "cos\nsystem"), "not a file of a bundle"),
        (lambda archive: archive.writestr("code/setup.py", "1/0"), "not a file of a bundle"),
        (lambda archive: archive.writestr("entries/\u202eevil.json", "{}"), "not a file of a bundle"),
        (link, "a link or special file"),
        (twice, "LICENSE' twice"),
        (bzip2, "another method than deflate"),
        (zeros(100 * 2**20), "more than 71303168 bytes"),
        (many(35 * 2**20), "more than 1000 files or 134217728 bytes"),
        (
            lambda archive: [archive.writestr(f"rows/{k}.csv", "") for k in range(5000)],
            "more than 1000 files",
        ),
    ],
)
def test_a_zip_with_forbidden_members_is_refused(tmp_path: Path, make: Make, said: str) -> None:
    path = zipped(tmp_path / "x.zip", make)
    started = time.process_time()
    (finding,) = check(path).findings
    assert time.process_time() - started < 2.0
    assert said in finding
    assert finding.isprintable()
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
def test_a_zip_with_false_sizes_or_checksums_is_refused(
    tmp_path: Path, files: Mapping[str, bytes], pack: Pack
) -> None:
    """Truncated anywhere, with claimed sizes of a gigabyte, and with the checksum of another file."""
    data = pack(files).read_bytes()
    path = tmp_path / "lie.zip"
    for cut in range(0, len(data) - 1, len(data) // 40):
        path.write_bytes(data[:cut])
        with pytest.raises(InputError, match="is not a readable zip"):
            read_files(path)
    directory = data.rfind(b"PK\x01\x02")
    claim = struct.pack("<I", 2**30)
    # The compressed size of the last file.
    path.write_bytes(data[: directory + 20] + claim + data[directory + 24 :])
    with pytest.raises(InputError, match="claims more bytes than the zip has"):
        read_files(path)
    # Its full size: reads what is there.
    path.write_bytes(data[: directory + 24] + claim + data[directory + 28 :])
    assert read_files(path) == dict(files)
    path.write_bytes(data[: directory + 16] + b"\0\0\0\0" + data[directory + 20 :])
    with pytest.raises(InputError, match="Bad CRC-32"):
        read_files(path)


def test_a_name_with_a_null_byte_is_refused(tmp_path: Path) -> None:
    path = zipped(tmp_path / "x.zip", lambda archive: archive.writestr("entries/a.json!.txt", "{}"))
    path.write_bytes(path.read_bytes().replace(b"a.json!", b"a.json\0"))
    (finding,) = check(path).findings
    assert "'entries/a.json\\x00.txt', which is not a file of a bundle" in finding


@pytest.mark.slow
def test_a_folder_with_links_and_pipes_is_refused(
    tmp_path: Path, files: Mapping[str, bytes], pack: Pack
) -> None:
    def with_link(folder: Path) -> None:
        (folder / "README.md").symlink_to("/etc/passwd")

    def with_linked_folder(folder: Path) -> None:
        (folder / "policies" / "other").symlink_to("/etc")

    def with_pipe(folder: Path) -> None:
        os.mkfifo(folder / "README.md")

    def with_more(folder: Path) -> None:
        (folder / "run.sh").write_text("true")

    for k, spoil in enumerate((with_link, with_linked_folder, with_pipe, with_more)):
        folder = pack(files, str(k))
        spoil(folder)
        (finding,) = check(folder).findings
        assert "a link or special file" in finding or "not a file of a bundle" in finding


def test_unreadable_bundles_give_exit_code_2(tmp_path: Path, run_cli: RunCli) -> None:
    (tmp_path / "empty.zip").write_bytes(b"")
    (tmp_path / "text.zip").write_text("hello")
    (tmp_path / "folder").mkdir()
    for name in ("empty.zip", "text.zip", "folder", "missing", "missing.zip"):
        ran = run_cli("validate", tmp_path / name)
        assert (ran.code, ran.out, ran.err.count("\n")) == (2, "", 1)
        assert ran.err.startswith("xmarl-bench: ")


def test_names_of_a_bundle_are_paths_inside_it() -> None:
    assert kind_of("policies/a..b/policy.json") == "card"
    for name in (
        "policies/../policy.json",
        "policies/./policy.json",
        "policies//policy.json",
        "LICENSE/",
        "",
    ):
        assert kind_of(name) is None
    assert sum(limit for _, limit in KINDS.values()) < 2**30
    assert MAX_FILES == 1000


@pytest.mark.slow
def test_a_zip_and_a_folder_are_read_alike(files: Mapping[str, bytes], pack: Pack) -> None:
    assert read_files(pack(files)) == dict(files)
    assert read_files(pack(files, "folder")) == dict(files)
    assert zipfile.is_zipfile(io.BytesIO(pack(files, "y.zip").read_bytes()))
