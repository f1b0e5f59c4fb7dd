"""Pieces are read from the cache complete or not at all."""

from __future__ import annotations

import itertools
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers.full_disk import files_of_at_most
from xmarl_bench.errors import InputError
from xmarl_bench.records.files import locked, remove_leftovers, write_atomically
from xmarl_bench.scoring.cache import Cache

KEY = "ab" + "0" * 62


@given(value=st.binary(max_size=200))
def test_written_pieces_are_read_unchanged(tmp_path_factory: pytest.TempPathFactory, value: bytes) -> None:
    cache = Cache(tmp_path_factory.mktemp("cache"))
    assert cache.read(KEY) is None
    assert not cache.has(KEY)
    cache.write(KEY, value)
    assert cache.read(KEY) == value
    cache.remove(KEY)
    assert not cache.has(KEY)


@given(cut=st.integers(0, 300), flipped=st.integers(0, 299))
def test_a_file_cut_short_or_changed_counts_as_missing(
    tmp_path_factory: pytest.TempPathFactory, cut: int, flipped: int
) -> None:
    cache = Cache(tmp_path_factory.mktemp("cache"))
    cache.write(KEY, b"x" * 235)  # 300 bytes with the digest's line
    whole = cache.path(KEY).read_bytes()
    assert len(whole) == 300
    cache.path(KEY).write_bytes(whole[:cut])
    assert cache.has(KEY) == (cut == 300)
    cache.path(KEY).write_bytes(whole[:flipped] + bytes([whole[flipped] ^ 1]) + whole[flipped + 1 :])
    assert not cache.has(KEY)


def test_an_error_is_kept_until_its_piece_succeeds(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    assert cache.failure(KEY) is None
    cache.fail(KEY, "out of memory")
    assert cache.failure(KEY) == "out of memory"
    assert not cache.has(KEY)
    cache.write(KEY, b"done")
    assert cache.failure(KEY) is None


def test_a_prepared_folder_is_a_cache_that_git_ignores(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache")
    cache.prepare()
    cache.prepare()
    assert (
        (cache.folder / "CACHEDIR.TAG")
        .read_bytes()
        .startswith(b"Signature: 8a477f597d28d172789f06886806bc55")
    )
    subprocess.run(["git", "init", "--quiet", str(tmp_path)], check=True)
    seen = subprocess.run(
        ["git", "-C", str(tmp_path), "status", "--porcelain"], check=True, capture_output=True, text=True
    )
    assert seen.stdout == ""


def test_temporary_files_of_dead_processes_are_deleted_and_others_kept(tmp_path: Path) -> None:
    dead = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True
    )
    here = socket.gethostname()
    names = {
        f".a.json.{here}-{dead.stdout.strip()}-x1.tmp": False,
        f".a.json.{here}-{os.getpid()}-x1.tmp": True,
        f".a.json.elsewhere-{dead.stdout.strip()}-x1.tmp": True,
        "a.json": True,
    }
    folders = tmp_path, tmp_path / "a" / "b"
    folders[1].mkdir(parents=True)
    for folder, name in itertools.product(folders, names):
        (folder / name).write_text("")
    remove_leftovers(tmp_path)
    for folder in folders:
        left = {path.name for path in folder.iterdir() if path.is_file()}
        assert left == {name for name, stays in names.items() if stays}


def test_the_temporary_file_of_a_killed_writer_is_deleted(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys; from pathlib import Path; import xmarl_bench.records.files as files\n"
        "def die(*_): os.kill(os.getpid(), signal.SIGKILL)\n"
        "files.os.fsync = die\n"
        f"files.write_atomically(Path({str(tmp_path)!r}) / 'a.json', b'x' * 10)\n"
    )
    done = subprocess.run([sys.executable, "-c", code])
    assert done.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 1
    remove_leftovers(tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_two_runs_cannot_write_into_one_folder(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from xmarl_bench.records.files import locked\n"
        "from xmarl_bench.errors import InputError\n"
        "try:\n"
        f"    with locked(Path({str(tmp_path)!r})): print('free')\n"
        "except InputError as error: print(error)\n"
    )

    def other() -> str:
        return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout

    with locked(tmp_path):
        assert f"another run is writing to {tmp_path}" in other()
    assert other() == "free\n"
    assert not list(tmp_path.iterdir())  # no lock file is left


def test_a_waiting_lock_waits(tmp_path: Path) -> None:
    entered = threading.Event()

    def enter() -> None:
        with locked(tmp_path, wait=True):
            entered.set()

    other = threading.Thread(target=enter)
    with locked(tmp_path, wait=True):
        other.start()
        assert not entered.wait(0.1)
    other.join()
    assert entered.is_set()
    assert not list(tmp_path.iterdir())


def test_a_lock_ends_with_the_process_that_held_it(tmp_path: Path) -> None:
    code = (
        "import os, signal; from pathlib import Path; from xmarl_bench.records.files import locked\n"
        f"with locked(Path({str(tmp_path)!r})): os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == -signal.SIGKILL
    with locked(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_a_full_disk_gives_one_sentence_and_keeps_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_atomically(path, b"old")
    with (
        files_of_at_most(1000),
        pytest.raises(InputError, match=r"a\.json cannot be written .*free disk space"),
    ):
        write_atomically(path, b"x" * 2000)
    assert path.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == ["a.json"]


def test_a_file_in_place_of_a_folder_gives_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot be written \(.*\): give another folder"):
        write_atomically(tmp_path / "file" / "a.json", b"")
    with pytest.raises(InputError, match="cannot write to"), locked(tmp_path / "file"):
        pass
