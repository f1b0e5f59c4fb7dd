"""A fresh environment that sees the packages of this one, so that plugins are really installed, quickly."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Environment:
    """A virtual environment of its own, whose packages are found before those of this one."""

    folder: Path

    @classmethod
    def make(cls, folder: Path) -> Environment:
        ours = sysconfig.get_paths()["purelib"]
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, timeout=120)
        (site,) = folder.glob("lib/python*/site-packages")
        # A line of code, so that the .pth files of this environment count too: the project's own is one.
        (site / "beside.pth").write_text(f"import site; site.addsitedir({ours!r})\n")
        return cls(folder)

    @property
    def python(self) -> Path:
        return self.folder / "bin" / "python"

    def install(self, *packages: Path) -> None:
        """Build and install, out of the network."""
        pip = (sys.executable, "-m", "pip", "--python", str(self.python), "install", "--quiet")
        options = ("--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check")
        done = self._run([*pip, *options, *map(str, packages)])
        assert done.returncode == 0, done.stderr

    def bench(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        """Run xmarl-bench there, in an empty folder."""
        return self._run([str(self.python), "-m", "xmarl_bench.cli", *map(str, arguments)])

    def pytest(self, package: Path) -> subprocess.CompletedProcess[str]:
        return self._run([str(self.python), "-m", "pytest", "-q", "-p", "no:cacheprovider", str(package)])

    def _run(self, command: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command, cwd=self.folder, capture_output=True, text=True, check=False, timeout=900
        )
