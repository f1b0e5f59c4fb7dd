"""How the commands end: version, full and closed outputs, arguments that are not text, failed writes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import pytest
import typer
from xmarl_baselines.training.command import main as train

from xmarl_bench.cli.main import main as bench
from xmarl_bench.cli.program import run

pytestmark = pytest.mark.usefixtures("as_a_program")
Main = Callable[[], None]
COMMANDS = [
    (bench, ["--version"]), (bench, ["--help"]), (bench, ["list", "tasks"]),
    (bench, ["list", "tasks", "--json"]),
    (train, ["--version"]), (train, ["--help"]),
]  # fmt: skip


def end(main: Main, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> object:
    """The exit code."""
    monkeypatch.setattr(sys, "argv", ["command", *arguments])
    try:
        main()
    except SystemExit as stop:
        return stop.code
    return 0


@pytest.mark.slow
def test_files_of_the_working_directory_hide_no_modules_from_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTHONSAFEPATH")
    (tmp_path / "random.py").write_text("raise SystemExit(1)")
    worker = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import random'], check=True)"
    program = f"from xmarl_bench.cli.program import run; run('name', lambda: exec({worker!r}), '')"
    subprocess.run([sys.executable, "-P", "-c", program], cwd=tmp_path, check=True, timeout=60)


@pytest.mark.parametrize("main", [bench, train])
def test_version(main: Main, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert end(main, ["--version"], monkeypatch) == 0
    assert capsys.readouterr().out == f"xmarl-bench {version('xmarl-bench')}\n"


@pytest.mark.parametrize(("main", "arguments"), COMMANDS)
def test_a_full_output_gives_one_sentence(
    main: Main, arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Path("/dev/full").open("w") as full:  # closing it fails if anything is still buffered
        monkeypatch.setattr(sys, "stdout", full)
        assert end(main, arguments, monkeypatch) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "the output cannot be written (No space left on device)" in said


@pytest.mark.parametrize(("main", "arguments"), COMMANDS)
def test_a_closed_pipe_ends_the_command_silently(
    main: Main, arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        assert end(main, arguments, monkeypatch) == 1
        monkeypatch.undo()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("main", [bench, train])
def test_an_argument_that_is_not_text_is_refused(
    main: Main, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert end(main, ["--out", "caf\udce9"], monkeypatch) == 2
    assert capsys.readouterr().err.endswith(
        r"argument b'caf\xe9' is not valid utf-8: rename the file or folder."
        "\n"
    )


def test_names_that_the_output_cannot_encode_are_printed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with (tmp_path / "out").open("w", encoding="ascii") as output:
        monkeypatch.setattr(sys, "stdout", output)
        run("command", lambda: print("caf\udce9 é"), "stopped.")
    assert (tmp_path / "out").read_text() == "caf\\udce9 \\xe9\n"


def test_a_failed_write_names_the_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def write() -> None:
        (tmp_path / "missing" / "file").write_text("")

    assert end(lambda: run("command", write, "stopped."), [], monkeypatch) == 2
    assert capsys.readouterr().err == (
        f"command: {tmp_path / 'missing' / 'file'} cannot be used (No such file or directory): give another "
        f"file or folder, or change its permissions.\n"
    )


def test_an_interrupt_has_its_own_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    app = typer.Typer()

    @app.command()
    def interrupted() -> None:
        raise KeyboardInterrupt

    for each in (interrupted, app):
        assert end(lambda each=each: run("command", each, "stopped."), [], monkeypatch) == 130  # type: ignore[misc]
        assert capsys.readouterr().err == "command: stopped.\n"
