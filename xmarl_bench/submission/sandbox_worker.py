"""The process of a third-party explainer: `python -m xmarl_bench.submission.sandbox_worker NAME LIMITS`.

Answers go to the original standard output; the explainer's own output is discarded.
"""

from __future__ import annotations

import json
import os
import pickle
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO, Any

from xmarl_bench.submission.limits import Limits


def main() -> None:
    name, limits = sys.argv[1], Limits(**json.loads(sys.argv[2]))
    answers = os.fdopen(os.dup(1), "wb")
    questions = os.fdopen(os.dup(0), "rb")
    with Path(os.devnull).open("r+b") as nowhere:
        for descriptor in (0, 1):
            os.dup2(nowhere.fileno(), descriptor)
    limits.apply()
    from xmarl_bench.errors import InputError

    def attempt(act: Callable[[], tuple[dict[str, Any], bytes]]) -> None:
        try:
            _send(answers, *act())
        except InputError as error:
            _send(answers, {"error": str(error)})
        except MemoryError:
            _send(
                answers, {"error": f"explainer {name!r} ran out of memory: raise the limit, or leave it out."}
            )

    worker = Worker(name)
    attempt(worker.load)
    while (question := _receive(questions)) is not None:
        attempt(partial(worker.answer, *question))


class Worker:
    """The explainer and its fitted copies."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.fitted: dict[str, Any] = {}

    def load(self) -> tuple[dict[str, Any], bytes]:
        """Load the explainer, which runs its code; returns its declarations, an `ExplainerRecord`."""
        from xmarl_bench.plugins.registry import find_explainer
        from xmarl_bench.scoring.score import explainer_record

        self.explainer = find_explainer(self.name)
        return explainer_record(self.explainer, 0).model_dump(mode="json"), b""

    def answer(
        self, what: str, policy: Any, observations: Any, seed: int, fitted: str | None, simulator: Any
    ) -> tuple[dict[str, Any], bytes]:
        """A mask (S, N, N) as float32 bytes, or the key of a fitted explainer."""
        import torch

        from xmarl_bench.explain.explainer import fit_explainer, run_explainer
        from xmarl_bench.reproducible import one_thread

        x = torch.tensor(observations)
        explainer = replace(self.explainer if fitted is None else self.fitted[fitted], simulator=simulator)
        with one_thread():
            if what == "fit":
                key = str(len(self.fitted))
                self.fitted[key] = fit_explainer(explainer, policy, x, seed)
                return {"key": key}, b""
            mask = run_explainer(explainer, policy, x, seed).numpy()
        return {"shape": list(mask.shape)}, mask.astype("<f4").tobytes()


def _receive(pipe: IO[bytes]) -> Any:
    """The harness's next question; None at the end. The harness is trusted, so it is unpickled."""
    length = pipe.read(8)
    if len(length) < 8:
        return None
    return pickle.loads(pipe.read(struct.unpack("<Q", length)[0]))


def _send(pipe: IO[bytes], header: dict[str, Any], payload: bytes = b"") -> None:
    data = json.dumps(header).encode()
    pipe.write(struct.pack("<IQ", len(data), len(payload)) + data + payload)
    pipe.flush()


if __name__ == "__main__":
    main()
