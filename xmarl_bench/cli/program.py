"""Runs a command line as a program. Invalid input and failed reads and writes end it with one sentence."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from xmarl_bench.errors import InputError
from xmarl_bench.origin.installed import package_version
from xmarl_bench.parallel.program_end import end_workers


def run(name: str, app: Callable[[], object], interrupted: str) -> None:
    """Run `app` with the arguments of this process; returns or raises SystemExit.

    Exit code 2 for invalid input and for a file or an output that cannot be read or written, 1 for a closed
    pipe, 130 after an interrupt.
    """
    # For workers, started with `python -m`: files of the working directory hide no modules there either.
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    try:
        _check_arguments(sys.argv[1:])
        if isinstance(sys.stdout, io.TextIOWrapper):  # prints every file name, as stderr does
            sys.stdout.reconfigure(errors="backslashreplace")
        try:
            app()
        finally:
            _flush()
    except InputError as error:
        _end(f"{name}: {error}", 2)
    except KeyboardInterrupt:
        _end(f"{name}: {interrupted}", INTERRUPTED)
    except SystemExit as stop:
        if stop.code != INTERRUPTED:
            raise
        _end(f"{name}: {interrupted}", INTERRUPTED)  # typer ends silently
    except OSError as error:
        if error.errno == errno.EPIPE:  # the reader closed the pipe, as `| head -1` does
            _end(None, 1)
        _end(f"{name}: {_what_failed(error)}", 2)
    finally:
        end_workers()


def run_function(function: Callable[..., object], interrupted: str = "stopped.") -> None:
    """Run the function of a module started with `python -m`, whose arguments are its options: see `run`."""
    run(Path(sys.argv[0]).stem, partial(typer.run, function), interrupted)


def _check_arguments(arguments: list[str]) -> None:
    """Raise InputError for an argument that is not text: entries and messages could not hold it."""
    for argument in arguments:
        try:
            argument.encode()
        except UnicodeEncodeError:
            raise InputError(
                f"argument {os.fsencode(argument)!r} is not valid {sys.getfilesystemencoding()}: rename the "
                f"file or folder."
            ) from None


def _flush() -> None:
    """Write buffered output, so that a full disk or a closed pipe raises here and not at exit."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        _discard_output()
        raise


def _discard_output() -> None:
    """Discard buffered output: Python would fail on it again at exit."""
    with suppress(OSError, ValueError):  # an output without a file descriptor
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _what_failed(error: OSError) -> str:
    why = error.strerror or str(error) or type(error).__name__
    if error.filename is None:
        return f"the output cannot be written ({why}): free disk space or write elsewhere."
    return f"{error.filename} cannot be used ({why}): give another file or folder, or change its permissions."


def _end(message: str | None, code: int) -> None:
    if message is not None:
        with suppress(OSError):
            # One line, although errors of users' code may have several.
            print(" ".join(message.split("\n")), file=sys.stderr, flush=True)
    raise SystemExit(code) from None


def _print_version(asked: bool) -> None:
    if asked:
        print(f"xmarl-bench {package_version('xmarl-bench') or 'unknown'}")
        raise typer.Exit


INTERRUPTED = 130  # exit code after Ctrl+C
Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
]
