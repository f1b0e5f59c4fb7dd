"""The process of a stranger's code: a fork of its keeper, or `python -m xmarl_bench.plugins.stranger CONFIG`.

Answers go to the original standard output; the code's own output is discarded.
"""

from __future__ import annotations

import json
import os
import pickle
import struct
import sys
import tempfile
from dataclasses import asdict, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import IO, Any

from xmarl_bench.isolation.keeper import PARENT_DEATH, prctl
from xmarl_bench.isolation.landlock import close_in
from xmarl_bench.isolation.limits import Limits
from xmarl_bench.parallel.loading import without_collector

Answer = tuple[dict[str, Any], bytes]


def serve(config: dict[str, Any]) -> None:
    """Answer questions from standard input until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    questions = os.fdopen(os.dup(0), "rb")
    with Path(os.devnull).open("r+b") as nowhere:
        for descriptor in (0, 1, 2):
            os.dup2(nowhere.fileno(), descriptor)
    prctl(PARENT_DEATH, 9)  # SIGKILL, which Windows does not name
    Limits(**config["limits"]).apply()
    if config["wall"] == "landlock":
        close_in([Path(each) for each in config["readable"]], Path(tempfile.gettempdir()))
    worker = Worker(config["name"])
    while (question := _receive(questions)) is not None:
        _send(answers, *_attempt(worker, question))


def _attempt(worker: Worker, question: dict[str, Any]) -> Answer:
    """The answer, or what was raised: this process goes on."""
    from xmarl_bench.errors import InputError

    try:
        return worker.answer(question)
    except InputError as error:
        return {"error": str(error)}, b""
    except MemoryError:
        return {"error": f"{worker.name} ran out of memory: raise the limit, or leave it out."}, b""
    except BaseException as error:  # the code may raise anything, also KeyboardInterrupt
        reason = f"{type(error).__name__}: {error}".rstrip(". \n")
        return {"error": f"{worker.name} failed ({reason}): correct it, or leave it out."}, b""


class Worker:
    """The explainer, its fitted copies, and the policies."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.explainer: Any = None
        self.fitted: dict[str, Any] = {}
        self.policies: Any = None
        self.tasks: Any = None

    def answer(self, question: dict[str, Any]) -> Answer:
        what = question["what"]
        if what == "policies":
            return self.list_policies(question)
        if what in ("task", "make", "reset", "step_task"):
            return self.play(question)
        with without_collector():  # before the code, so that it cannot be kept from loading
            from xmarl_bench.plugins.stranger_policies import Policies, open_code

        if self.policies is None:
            self.policies = Policies()
        answers = {"load": self.load, "explain": self.run, "fit": self.run, "open": open_code}
        answer: Answer = answers.get(what, self.policies.answer)(question)
        return answer

    def load(self, question: dict[str, Any]) -> Answer:
        """Load an explainer, which runs its code; returns its declarations."""
        from xmarl_bench.explain.adapters import origin_of_explainer
        from xmarl_bench.explain.simulator import SIMULATOR
        from xmarl_bench.isolation.explainers import DECLARED
        from xmarl_bench.origin.code_hash import object_sha256
        from xmarl_bench.plugins.registry import find_explainer

        name = question.get("explainer")
        self.explainer = pickle.loads(question["pickled"]) if name is None else find_explainer(name)
        self.name = f"explainer {self.explainer.name!r}"
        if name is None:
            return {}, b""
        found, origin = self.explainer, origin_of_explainer(self.explainer)
        declared = {
            **{field: getattr(found, field) for field in DECLARED},
            **asdict(origin),
            "hyperparameters": dict(found.hyperparameters),
            "accesses": SIMULATOR if found.simulates else found.accesses,
            "needs_fit": found.fit is not None,
            "seed": 0,
            "key": object_sha256(replace(found, summary="", origin=None)),
        }
        return declared, b""

    def play(self, question: dict[str, Any]) -> Answer:
        """Make the task of others, or step its episodes."""
        from xmarl_bench.plugins.stranger_tasks import Tasks

        if self.tasks is None:
            self.tasks = Tasks()
        answer: Answer = self.tasks.answer(question)
        return answer

    def list_policies(self, question: dict[str, Any]) -> Answer:
        """The policies of a plugin: folders of bundles by name, and the names of those that are code."""
        from xmarl_bench.plugins.names import places_of_plugin

        name, value, group = question["plugin"]
        self.name = f"plugin {name!r}"
        places = places_of_plugin(EntryPoint(name, value, group))
        folders = {name: str(place) for name, place in places.items() if isinstance(place, Path)}
        return {"folders": folders, "code": [name for name in places if name not in folders]}, b""

    def run(self, question: dict[str, Any]) -> Answer:
        """A mask (S, N, N) as float32 bytes; nothing for a fit, which is kept."""
        import torch

        from xmarl_bench.explain.explainer import fit_explainer, run_explainer
        from xmarl_bench.reproducible import one_thread

        self.policies.receive(question)
        policy, x = self.policies.get(question["policy"]), torch.tensor(question["observations"])
        seed, key, shipped = question["seed"], question["fitted"], question["shipped"]
        explainer = self.explainer if shipped is None else pickle.loads(shipped)
        explainer = replace(explainer, device=question["device"])
        with one_thread():
            if question["what"] == "fit":
                for forgotten in question["fits"]:
                    del self.fitted[forgotten]
                self.fitted[key] = fit_explainer(explainer, policy, x, seed)
                return {}, b""
            explainer = explainer if key is None else self.fitted[key]
            mask = run_explainer(replace(explainer, simulator=question["simulator"]), policy, x, seed).numpy()
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
    serve(json.loads(sys.argv[1]))
