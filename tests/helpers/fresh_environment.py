"""A fresh environment that also sees the packages of this one, so that installing plugins is quick."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Environment:
    """A virtual environment whose packages are found before those of this one."""

    folder: Path

    @classmethod
    def make(cls, folder: Path) -> Environment:
        ours = sysconfig.get_paths()["purelib"]
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, timeout=120)
        (site,) = folder.glob("lib/python*/site-packages")
        # A line of code, so that .pth files of this environment work too, such as the project's own.
        (site / "beside.pth").write_text(f"import site; site.addsitedir({ours!r})\n")
        return cls(folder)

    @property
    def python(self) -> Path:
        return self.folder / "bin" / "python"

    def install(self, *packages: Path) -> None:
        """Build and install without network."""
        pip = (sys.executable, "-m", "pip", "--python", str(self.python), "install", "--quiet")
        options = ("--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check")
        command = [*pip, *options, *map(str, packages)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=900)
        assert done.returncode == 0, done.stderr
