"""Runs command lines in forks of one process that has imported everything (see zygote.py)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.helpers.zygote import Answer, Request

ZYGOTE = Path(__file__).with_name("zygote.py")
Ask = Callable[[Request], Answer]


@contextmanager
def forks(python: Path | str = sys.executable) -> Iterator[Ask]:
    """Yields ask(request) -> answer, which runs in the environment of that Python."""
    if not hasattr(os, "fork"):
        pytest.skip("needs os.fork")
    with subprocess.Popen(
        [str(python), "-P", str(ZYGOTE)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    ) as zygote:
        lines, answers = zygote.stdin, zygote.stdout
        assert lines is not None
        assert answers is not None

        def ask(request: Request) -> Answer:
            print(json.dumps(request), file=lines, flush=True)
            answer: Answer = json.loads(answers.readline())
            return answer

        yield ask
        lines.close()
