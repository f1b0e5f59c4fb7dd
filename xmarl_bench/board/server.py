"""Serves the files of a board's folder to this machine."""

from __future__ import annotations

import os
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler
from pathlib import Path
from typing import BinaryIO


class PlainFiles(SimpleHTTPRequestHandler):
    """Serves regular files below its directory. Follows no symbolic link and lists no folder."""

    def send_head(self) -> BinaryIO | None:
        asked, root = Path(self.translate_path(self.path)), Path(self.directory)
        if asked.is_file() and Path(os.path.realpath(asked)) == Path(
            os.path.realpath(root)
        ) / os.path.relpath(asked, root):
            return super().send_head()
        self.send_error(HTTPStatus.NOT_FOUND)
        return None
