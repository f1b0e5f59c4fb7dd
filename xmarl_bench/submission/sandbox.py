"""Runs a third-party explainer in a separate, isolated process, and calls it over a pipe.

The harness sends policy and observations, receives masks, and measures them itself on its own policy. So the
explainer's code can return bad masks but cannot change scores: it returns numbers, never objects.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import platform
import select
import signal
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explain
from xmarl_bench.explain.simulated import SIMULATOR, Simulated
from xmarl_bench.policy import Policy
from xmarl_bench.records.strict_json import shown
from xmarl_bench.rollout.simulator import Simulator
from xmarl_bench.submission.limits import UNIX, Limits, Wall, environment, python_folders, strongest, walled

MAX_HEADER, MAX_MASKS = 64 * 1024, 1 << 30
WORKER = "xmarl_bench.submission.sandbox_worker"


@dataclass
class Sandbox:
    """One explainer in a process isolated by `wall`. End it with `close`, or use a `with` statement.

    explainer: a registered name, module:Name or path/to/file.py:Name.
    """

    explainer: str
    limits: Limits = field(default_factory=Limits)
    wall: Wall = field(default_factory=strongest)
    process: subprocess.Popen[bytes] | None = None
    simulates: bool = False  # once it is started: whether the explainer asks for simulators

    def start(self) -> dict[str, Any]:
        """Start the process; returns the explainer's declarations, the fields of `ExplainerRecord`.

        Raises InputError if the explainer cannot be loaded, and on systems without process limits.
        """
        if not UNIX:
            raise InputError(
                f"third-party explainers run isolated, which {platform.system()} does not offer: run this on "
                f"Linux, or use --tier recompute, which runs none of their code."
            )
        command = [sys.executable, "-m", WORKER, self.explainer, json.dumps(vars(self.limits))]
        readable = python_folders()
        file = Path(self.explainer.rpartition(":")[0])
        if file.suffix == ".py" and file.is_file():
            readable.append(file.resolve())
        self.process = subprocess.Popen(
            walled(self.wall, command, readable),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment(),
            start_new_session=True,
        )
        declared = self._receive()[0]
        self.simulates = declared.get("accesses") == SIMULATOR
        return declared

    def explains(self, fitted: str | None = None) -> Explain | Simulated:
        """What asks the process. fitted: the key of what `fit` left there, to explain instead."""
        explain = partial(self.explain, fitted=fitted)
        return Simulated(explain) if self.simulates else explain

    def explain(
        self,
        policy: Policy,
        observations: Tensor,
        generator: torch.Generator,
        simulator: Simulator | None = None,
        *,
        fitted: str | None = None,
    ) -> Tensor:
        """(S, N, D) -> (S, N, N), unchecked: `run_explainer` checks it, as for any explainer."""
        header, payload = self._ask("explain", policy, observations, generator, fitted, simulator)
        shape = header.get("shape")
        n_steps, n_agents, _ = observations.shape
        if shape != [n_steps, n_agents, n_agents] or len(payload) != 4 * n_steps * n_agents**2:
            raise InputError(
                f"explainer {shown(self.explainer)} did not return a mask (S, N, N): correct it."
            )
        return torch.tensor(np.frombuffer(payload, dtype="<f4").reshape(shape))

    def fit(self, policy: Policy, observations: Tensor, generator: torch.Generator) -> Explain | Simulated:
        """(S, N, D) states to fit on -> the fitted explainer, which stays in the process."""
        header, _ = self._ask("fit", policy, observations, generator)
        return self.explains(str(header.get("key")))

    def close(self) -> None:
        """End the process and all others in its session."""
        if self.process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            for pipe in (self.process.stdin, self.process.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()
            self.process = None

    def __enter__(self) -> Sandbox:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(
        self,
        what: str,
        policy: Policy,
        observations: Tensor,
        generator: torch.Generator,
        fitted: str | None = None,
        simulator: Simulator | None = None,
    ) -> tuple[dict[str, Any], bytes]:
        """Send a question and wait for its answer. Sends the seed of the generator, which is unused yet."""
        question = (what, policy, observations.numpy(), generator.initial_seed(), fitted, simulator)
        data = pickle.dumps(question)
        try:
            stdin = self._pipe("stdin")
            stdin.write(struct.pack("<Q", len(data)) + data)
            stdin.flush()
        except OSError:
            raise self._ended() from None
        return self._receive()

    def _receive(self) -> tuple[dict[str, Any], bytes]:
        deadline = time.monotonic() + self.limits.answer_seconds
        lengths = struct.unpack("<IQ", self._read(12, deadline))
        if lengths[0] > MAX_HEADER or lengths[1] > MAX_MASKS:
            raise InputError(f"explainer {shown(self.explainer)} returned too many bytes: correct it.")
        try:
            header = json.loads(self._read(lengths[0], deadline))
        except (ValueError, RecursionError):
            header = None
        payload = self._read(lengths[1], deadline)
        if not isinstance(header, dict):
            raise InputError(f"explainer {shown(self.explainer)} returned invalid JSON: correct it.")
        if "error" in header:
            raise InputError(shown(header["error"], 500)[1:-1])
        return header, payload

    def _read(self, n_bytes: int, deadline: float) -> bytes:
        """Read exactly `n_bytes`. Raises InputError if the process ended or takes too long."""
        out = self._pipe("stdout").fileno()
        parts = bytearray()
        while len(parts) < n_bytes:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([out], [], [], left)[0]:
                self.close()
                raise InputError(
                    f"explainer {shown(self.explainer)} did not answer within "
                    f"{self.limits.answer_seconds:g} s: give it more time, or leave it out."
                )
            part = os.read(out, min(n_bytes - len(parts), 1 << 20))
            if not part:
                raise self._ended()
            parts += part
        return bytes(parts)

    def _pipe(self, name: str) -> IO[bytes]:
        pipe: IO[bytes] | None = getattr(self.process, name, None)
        if pipe is None:
            raise self._ended()
        return pipe

    def _ended(self) -> InputError:
        code = None
        if self.process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = self.process.wait(timeout=5)
        self.close()
        return InputError(
            f"the process of explainer {shown(self.explainer)} ended (exit code {code}), maybe at a limit of "
            f"{self.limits.memory_bytes / 2**30:g} GiB or {self.limits.cpu_seconds} s: raise the limits, or "
            f"leave it out."
        )
