"""The packages work on Windows as far as can be seen from here: imports, functions of Unix, encodings."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import xmarl_baselines
import xmarl_envs

import xmarl_bench

PACKAGES = [Path(str(package.__file__)).parent for package in (xmarl_envs, xmarl_bench, xmarl_baselines)]
DOCS = Path(__file__).parents[1] / "docs"

# Imports every module. Modules of Unix do not exist for ours; other packages look after themselves.
IMPORT_ALL = """
import builtins, importlib, pkgutil

unix = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}
real = builtins.__import__

def portable(name, globals=None, locals=None, fromlist=(), level=0):
    if name in unix and str((globals or {}).get("__name__")).startswith("xmarl_"):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return real(name, globals, locals, fromlist, level)

builtins.__import__ = portable
count = 0
for top in ("xmarl_envs", "xmarl_bench", "xmarl_baselines"):
    for module in pkgutil.walk_packages(importlib.import_module(top).__path__, f"{top}."):
        importlib.import_module(module.name)
        count += 1
print(count)
"""
# Absent on Windows: https://docs.python.org/3/library/os.html and signal.html ("Availability: Unix").
UNIX = {
    "os": {
        "chown", "fchmod", "fork", "forkpty", "getegid", "geteuid", "getgid", "getloadavg", "getpgid",
        "getuid", "killpg", "mkfifo", "nice", "register_at_fork", "sched_getaffinity", "setgid",
        "setsid", "setuid", "sysconf", "uname", "wait", "waitid", "O_NOFOLLOW", "O_NONBLOCK",
    },
    "signal": {"SIGALRM", "SIGCHLD", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGSTOP", "SIGUSR1", "alarm"},
}  # fmt: skip
REFUSES = {"fork_server.py", "process.py", "keeper.py"}  # run on Unix only, and say so


def files(*folders: Path) -> Iterator[tuple[Path, ast.Module]]:
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            yield path, ast.parse(path.read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.usefixtures("needs_torch")
def test_every_module_imports_without_the_modules_of_unix() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    n_modules = sum(path.name != "__init__.py" for package in PACKAGES for path in package.rglob("*.py"))
    assert int(done.stdout) >= n_modules


def unix_only(tree: ast.Module) -> set[str]:
    return {
        f"{node.value.id}.{node.attr}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.attr in UNIX.get(node.value.id, ())
    }


@pytest.mark.slow
def test_functions_of_unix_are_used_only_where_windows_is_refused() -> None:
    found = {path.name: names for path, tree in files(*PACKAGES) if (names := unix_only(tree))}
    assert found.keys() == REFUSES, found


def without_encoding(tree: ast.Module) -> list[int]:
    """Lines that read or write text in the encoding of the system: UTF-8 on Linux, another on Windows."""
    lines = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", None)
        given = {each.arg: each.value for each in node.keywords}
        first = given.get("mode", node.args[0] if node.args else None)
        mode = str(first.value) if isinstance(first, ast.Constant) else ""
        text = name in {"read_text", "write_text"} or (
            name == "open"
            and isinstance(node.func, ast.Attribute)
            and mode in {"r", "w", "a", "x", "rt", "wt"}
        )
        if (text or "text" in given or "universal_newlines" in given) and "encoding" not in given:
            lines.append(node.lineno)
    return lines


@pytest.mark.slow
def test_text_is_read_and_written_as_utf_8() -> None:
    found = {str(path): lines for path, tree in files(*PACKAGES, DOCS) if (lines := without_encoding(tree))}
    assert not found


@pytest.mark.parametrize(
    "code",
    ["p.read_text()", "p.write_text('ä')", "p.open('w')", "p.open(mode='a')", "run(command, text=True)"],
)
def test_a_missing_encoding_is_seen(code: str) -> None:
    assert without_encoding(ast.parse(code)) == [1]
    assert without_encoding(ast.parse(f"{code[:-1]}, encoding='utf-8')".replace("(, ", "("))) == []


def test_committed_files_have_names_for_every_system() -> None:
    """No file of the project is a device of Windows, and no two differ in case only."""
    from xmarl_bench.records.field_types import RESERVED

    for package in PACKAGES:
        names = [
            str(path.relative_to(package)) for path in package.rglob("*") if "__pycache__" not in path.parts
        ]
        assert len({name.lower() for name in names}) == len(names)
        assert not [
            name for name in names if RESERVED.fullmatch(Path(name).name) or set(name) & set('<>:"|?*')
        ]
