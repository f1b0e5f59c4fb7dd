"""Builds the documentation site, with search: `make docs`, or `python docs/make_site.py [folder]`.

Needs the extra `docs` only. Its pages are the documents that docs/mkdocs.yml names. A link to a file that is
not a page, such as source code, becomes its text.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "docs" / "mkdocs.yml"
LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)#\s]+)(#[^)]*)?\)")
# Renders the formulas that pymdownx.arithmatex marks.
MATHJAX = "window.MathJax = {tex: {inlineMath: [['\\\\(', '\\\\)']], displayMath: [['\\\\[', '\\\\]']]}};\n"


def pages() -> list[str]:
    """The documents of the site, relative to the repository, in their order."""
    return re.findall(r":\s+(\S+\.md)$", CONFIG.read_text(encoding="utf-8"), re.MULTILINE)


def collect(folder: Path) -> None:
    """Copy the pages and their pictures into `folder`, in the layout of the repository."""
    chosen = set(pages())
    for name in chosen:
        place = PurePosixPath(name).parent

        def linked(link: re.Match[str], place: PurePosixPath = place) -> str:
            picture, text, target, _ = link.groups()
            file = (ROOT / place / target).resolve().relative_to(ROOT)
            if picture:
                copy = folder / file
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(ROOT / file, copy)
                return link.group()
            return link.group() if file.as_posix() in chosen else text

        written = folder / name
        written.parent.mkdir(parents=True, exist_ok=True)
        page = LINK.sub(linked, (ROOT / name).read_text(encoding="utf-8"))
        written.write_text(page, encoding="utf-8", newline="\n")
    (folder / "mathjax.js").write_text(MATHJAX, encoding="utf-8", newline="\n")


def main() -> int:
    out = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "site").resolve()
    with tempfile.TemporaryDirectory() as temporary:
        collect(Path(temporary) / "pages")
        config = shutil.copy(CONFIG, temporary)
        command = ["mkdocs", "build", "--strict", "--quiet", "--config-file", config, "--site-dir", str(out)]
        code = subprocess.run([sys.executable, "-m", *command]).returncode
    print(f"{out / 'index.html'}" if code == 0 else "the site was not built.")
    return code


if __name__ == "__main__":
    sys.exit(main())
