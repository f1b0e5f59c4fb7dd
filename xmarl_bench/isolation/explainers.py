"""Explainers of others, asked over a pipe: each runs in a process of its own, and the harness measures.

A process is started when it is first asked, in every process of the harness that asks, and answers a whole
episode at a time. It keeps the policies that it was sent and the explainers that it has fitted. One that
ended or did not answer is not started again in the same run: it gives the same error at once.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import secrets
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, NoReturn

import cloudpickle
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, ValidationError
from torch import Tensor

from xmarl_bench.entry.schema import ExplainerRecord
from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import origin_of_explainer
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.simulated import SIMULATOR, Simulated
from xmarl_bench.isolation.limits import UNLIMITED, Limits
from xmarl_bench.isolation.process import Stranger
from xmarl_bench.isolation.walls import Wall
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.origin.code_hash import object_sha256
from xmarl_bench.origin.references import Origin
from xmarl_bench.policy import Policy
from xmarl_bench.records.field_types import Text
from xmarl_bench.records.strict_json import first_error, shown
from xmarl_bench.rollout.simulator import Simulator

PROCESSES_KEPT = 8  # in each process of the harness
POLICIES_KEPT = 4  # in each process of an explainer
FITS_KEPT = 8


@dataclass(frozen=True)
class Isolation:
    """How strangers' processes are kept apart."""

    limits: Limits = UNLIMITED
    wall: Wall = "process"


@dataclass(frozen=True)
class Source:
    """What a process loads: a registered name, a reference to code, or a pickled explainer."""

    name: str  # for messages
    content: str | bytes
    isolation: Isolation
    readable: tuple[Path, ...] = ()
    token: str = field(default_factory=secrets.token_hex)  # another one in each run, which reads files anew

    def question(self) -> dict[str, Any]:
        kind = "explainer" if isinstance(self.content, str) else "pickled"
        return {"what": "load", kind: self.content}


class Declared(ExplainerRecord):
    """What a process declares of its explainer."""

    slow: bool
    summary: Text
    absence: Absence | None
    signed: bool  # type: ignore[assignment]
    key: Text | None
    hyperparameters: Annotated[dict[Text, bool | int | float | Text | None], Field(max_length=100)]


@dataclass(frozen=True)
class Asked:
    """Asks the process of a source: see `xmarl_bench.explain.explainer.Elsewhere`."""

    source: Source
    key: str
    fit_on: tuple[Policy, NDArray[np.float32], int] | None = None  # policy, (S, N, D) states, seed

    def explain(self, policy: Policy, observations: Tensor, seed: int, simulator: Simulator | None) -> Tensor:
        """(S, N, D) -> (S, N, N), unchecked."""
        process = _process(self.source)
        fitted = None if self.fit_on is None else process.fit(*self.fit_on)
        return process.explain(policy, observations, seed, simulator, fitted)

    def fit(self, policy: Policy, observations: Tensor, seed: int) -> Asked:
        """(S, N, D) states -> what asks the fitted explainer. Other processes fit it again."""
        fit_on = policy, observations.numpy(), seed
        _process(self.source).fit(*fit_on)
        return replace(self, fit_on=fit_on)


def isolate(explainer: Explainer, isolation: Isolation = Isolation()) -> Explainer:
    """The same explainer, asked over a pipe: it is sent to its process by value.

    Raises InputError if it cannot be pickled.
    """
    try:
        content = bytes(cloudpickle.dumps(replace(explainer, elsewhere=None)))
    except Exception as error:
        raise InputError(
            f"explainer {explainer.name!r} cannot be sent to a process of its own ({type(error).__name__}: "
            f"{error}): keep files, locks and connections out of it, or run it here (isolate=False)."
        ) from error
    key = object_sha256(replace(explainer, summary="", origin=None)) or secrets.token_hex()
    return _asking(explainer, Asked(Source(f"explainer {explainer.name}", content, isolation), key))


def find_elsewhere(
    name: str, origin: Origin | None, readable: Sequence[Path], isolation: Isolation
) -> Explainer:
    """An explainer by name or reference, loaded in a process of its own and never here.

    origin: where it comes from, if it is known without asking. Raises InputError if it does not load.
    """
    source = Source(f"explainer {Path(name).name}", name, isolation, tuple(readable))
    header = _process(source).declared
    try:
        declared = Declared.model_validate(header, strict=False)
    except ValidationError as error:
        problem, where = first_error(error)
        raise InputError(
            f"explainer {name!r} declares no valid {shown(where)} ({shown(problem)}): correct it."
        ) from None
    found = Explainer(
        **{
            name: getattr(declared, name)
            for name in (
                "name", "summary", "stochastic", "slow", "control", "hyperparameters", "batched", "binary",
                "signed", "node_importance", "absence",
            )
        },
        explain=Simulated(_not_here) if declared.accesses == SIMULATOR else _not_here,
        accesses=None if declared.accesses == SIMULATOR else declared.accesses,
        fit=_not_here if declared.needs_fit else None,
        origin=origin
        or Origin(declared.distribution, declared.version, declared.entry_point, declared.code_sha256),
    )  # fmt: skip
    return _asking(found, Asked(source, declared.key or secrets.token_hex()))


def _asking(explainer: Explainer, asked: Asked) -> Explainer:
    return replace(
        explainer,
        explain=Simulated(_not_here) if explainer.simulates else _not_here,
        fit=None if explainer.fit is None else _not_here,
        origin=explainer.origin or origin_of_explainer(explainer),
        elsewhere=asked,
    )


def _not_here(*_: object) -> NoReturn:
    raise InputError("this explainer runs in a process of its own: call it by `run_explainer`.")


def end_strangers() -> None:
    """End the processes of all strangers that this process has started."""
    for each in _running().values():
        if isinstance(each, Conversation):
            each.process.close()
    _running().clear()


class Conversation:
    """A running process, and what it has been sent."""

    def __init__(self, source: Source) -> None:
        isolation = source.isolation
        self.source = source
        self.process = Stranger(source.name, isolation.limits, isolation.wall, source.readable)
        self.policies: OrderedDict[str, None] = OrderedDict()
        self.fits: OrderedDict[str, None] = OrderedDict()
        self.declared = self._ask(source.question())[0]

    def explain(
        self,
        policy: Policy,
        observations: Tensor,
        seed: int,
        simulator: Simulator | None,
        fitted: str | None,
    ) -> Tensor:
        n_steps, n_agents, _ = observations.shape
        header, payload = self._ask(
            {
                "what": "explain",
                **self._sent(policy),
                "observations": observations.numpy(),
                "seed": seed,
                "simulator": simulator,
                "fitted": fitted,
            }
        )
        shape = header.get("shape")
        if shape != [n_steps, n_agents, n_agents] or len(payload) != 4 * n_steps * n_agents**2:
            raise InputError(f"{self.source.name} did not return a mask (S, N, N): correct it.")
        return torch.tensor(np.frombuffer(payload, dtype="<f4").reshape(shape))

    def fit(self, policy: Policy, observations: NDArray[np.float32], seed: int) -> str:
        """Fit the explainer, unless the process has done it; returns the key of the fitted one."""
        sent = self._sent(policy)
        parts = (sent["policy"].encode(), observations.tobytes(), str(seed).encode())
        key = hashlib.sha256(b" ".join(parts)).hexdigest()
        if key in self.fits:
            self.fits.move_to_end(key)
            return key
        forget = _forget(self.fits, FITS_KEPT)
        self._ask(
            {"what": "fit", **sent, "observations": observations, "seed": seed, "fitted": key, "fits": forget}
        )
        self.fits[key] = None
        return key

    def _sent(self, policy: Policy) -> dict[str, Any]:
        """The key of a policy, and its bytes if the process does not have it."""
        data = bytes(cloudpickle.dumps(policy))
        key = hashlib.sha256(data).hexdigest()
        if key in self.policies:
            self.policies.move_to_end(key)
            return {"policy": key}
        forget = _forget(self.policies, POLICIES_KEPT)
        self.policies[key] = None
        return {"policy": key, "weights": data, "policies": forget}

    def _ask(self, question: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        try:
            return self.process.ask(question)
        except InputError as error:
            if not self.process.running:
                _running()[self.source.token] = error
            raise


def _forget(known: OrderedDict[str, None], kept: int) -> list[str]:
    """Drop the oldest keys, to make place for one more."""
    return [known.popitem(last=False)[0] for _ in range(len(known) - kept + 1)]


_of_process: dict[int, OrderedDict[str, Conversation | InputError]] = {}  # by the harness's process id


def _running() -> OrderedDict[str, Conversation | InputError]:
    """Conversations by token, of this process: a fork has none. An error is of one that has ended."""
    return _of_process.setdefault(os.getpid(), OrderedDict())


def _process(source: Source) -> Conversation:
    running = _running()
    found = running.get(source.token)
    if isinstance(found, InputError):
        raise InputError(str(found))
    if found is None:
        alive = [key for key, each in running.items() if isinstance(each, Conversation)]
        for key in alive[: max(0, len(alive) - PROCESSES_KEPT + 1)]:
            ended = running.pop(key)
            if isinstance(ended, Conversation):
                ended.process.close()
        found = running[source.token] = Conversation(source)
    running.move_to_end(source.token)
    return found


atexit.register(end_strangers)
