"""Runs tests on every Python at hand, each in its own environment.

By default the tests that need no large package such as torch; with --whole all packages and the whole suite.
With --lowest the lowest versions that pyproject.toml allows, and of --whole the quick tests.
With --newest today's release of every library, and the tests of the environments with their clients.

    python tests/pythons.py [--whole] [--lowest | --newest] [3.12 3.13]
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VERSIONS = ("3.11", "3.12", "3.13", "3.14")
LIGHT = "not training and not browser and not cluster and not benchmark"  # these need large packages
QUICK = f"not slow and {LIGHT}"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("versions", nargs="*", default=VERSIONS, metavar="3.x")
    parser.add_argument("--whole", action="store_true", help="all packages and the whole suite")
    releases = parser.add_mutually_exclusive_group()
    releases.set_defaults(releases="pinned")
    for name, of in (("lowest", "versions of constraints-lowest.txt"), ("newest", "today's releases")):
        releases.add_argument(f"--{name}", action="store_const", const=name, dest="releases", help=of)
    asked = parser.parse_args()
    results: dict[str, str] = {}
    for version in asked.versions:
        python = interpreter(version)
        if python is None:
            results[version] = "not installed here"
            continue
        print(f"Python {version}", flush=True)
        environment = made(python, version, asked.whole, asked.releases)
        command: list[str | Path] = [environment, "-m", "pytest", *options(asked.whole, asked.releases)]
        code = subprocess.run(command, cwd=ROOT).returncode
        results[version] = "passed" if code == 0 else f"failed (exit code {code})"
    print(*(f"Python {version}: {result}" for version, result in results.items()), sep="\n")
    tested = [result for result in results.values() if result != "not installed here"]
    return int(not tested or set(tested) != {"passed"})


def interpreter(version: str) -> str | None:
    """A Python of this version that can make environments: this one, of the PATH or of pyenv."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    places = [f"python{version}", sys.executable, *map(str, sorted(pyenv.glob(f"{version}.*/bin/python")))]
    for place in filter(None, map(shutil.which, places)):
        check = "import ensurepip, sys, venv; print('%d.%d' % sys.version_info[:2])"
        found = subprocess.run([place, "-c", check], capture_output=True, encoding="utf-8")
        if found.returncode == 0 and found.stdout.strip() == version:
            return place
    return None


def made(python: str, version: str, whole: bool, releases: str) -> Path:
    """The Python of an environment, such as `.venv-3.12` or `.venv-lowest-3.12`, with what the tests need."""
    folder = ROOT / (f".venv-{version}" if releases == "pinned" else f".venv-{releases}-{version}")
    program = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not program.exists():
        subprocess.run([python, "-m", "venv", folder], check=True)
    install: list[str | Path] = [program, "-m", "pip", "install", "--quiet"]
    if releases == "newest":
        # BenchMARL needs an older TorchRL.
        clients = [each for each in requirements() if not each.startswith("benchmarl")]
        install += ["--upgrade", "--upgrade-strategy", "eager"]
        subprocess.run([*install, *clients, "--editable", ROOT], check=True)
        return program
    name = "constraints.txt" if releases == "pinned" else "constraints-lowest.txt"
    install += ["--constraint", ROOT / name]
    if whole:
        subprocess.run([*install, "--editable", f"{ROOT}[dev]"], check=True)
    else:
        subprocess.run([*install, *light_requirements()], check=True)
        subprocess.run([*install, "--no-deps", "--editable", ROOT], check=True)
    return program


def light_requirements() -> list[str]:
    """What the project and its tests need, without the large packages and those that need one of them."""
    from tests.helpers.large import LARGE

    return [each for each in requirements() if re.split(r"[^\w.-]", each, maxsplit=1)[0] not in LARGE]


def requirements() -> list[str]:
    """What the project and its tests need, as in pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras: dict[str, list[str]] = project["optional-dependencies"]
    needed = {*project["dependencies"], *extras["dev"]}
    for name, more in extras.items():
        if f"{project['name']}[{name}]" in needed:
            needed = needed - {f"{project['name']}[{name}]"} | set(more)
    return sorted(needed)


def options(whole: bool, releases: str) -> list[str]:
    if releases == "newest":
        return ["tests/envs"]
    if whole:
        if releases == "lowest":
            return ["-m", QUICK]
        return [] if sys.platform == "linux" else ["-m", "not browser"]  # Chromium is found on Linux only
    return ["--light", "-m", LIGHT]


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main())
