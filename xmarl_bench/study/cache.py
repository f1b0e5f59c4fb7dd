"""Scores that a study needs, each computed once: a folder of entries named by what they were made of.

The name of an entry's file ends with the hash of everything its numbers depend on: policy (weights,
architecture), explainer (version, code of its module, hyperparameters, seed), states and the protocol's
definitions. Change one of these and that entry is scored again, and no other. Code that an explainer's module
imports is covered by the version of its package alone.
"""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from xmarl_bench.entry import SCHEMA_VERSION, Entry, read_entry
from xmarl_bench.errors import InputError
from xmarl_bench.files import canonical_json, write_json
from xmarl_bench.protocol import DEFINITIONS, PROTOCOL
from xmarl_bench.provenance import package_version
from xmarl_bench.registry import FoundExplainer
from xmarl_bench.request import Request
from xmarl_bench.scoring import score_requests

DECLARED = ("stochastic", "control", "batched", "binary", "signed", "accesses")


@dataclass(frozen=True)
class Cache:
    """Entries of a study, in one folder."""

    folder: Path

    def path(self, request: Request) -> Path:
        key = content_key(request)
        return self.folder / f"{request.card.name}.{request.explainer.explainer.name}.{key[:16]}.json"

    def read(self, request: Request) -> Entry | None:
        """None where it is missing, or is not (any more) an entry that fits its id."""
        path = self.path(request)
        try:
            return read_entry(path) if path.exists() else None
        except InputError:
            return None

    def complete(
        self, requests: Sequence[Request], *, jobs: int = 1, progress: bool = False, submitter: str | None
    ) -> list[Entry]:
        """An entry per request, in order: read, or scored and written as soon as it is there.

        Goes policy by policy, for the explainers of one share its episodes: a run that is stopped loses at
        most the policy that it was at.
        """
        found = [self.read(request) for request in requests]
        missing = [
            (k, request)
            for k, (request, entry) in enumerate(zip(requests, found, strict=True))
            if entry is None
        ]
        started, n_done = time.monotonic(), 0
        if progress and missing:
            _say(f"{len(requests) - len(missing)} of {len(requests)} scores are in {self.folder}.")
        for _, group in groupby(missing, key=lambda pair: _world(pair[1])):
            members = list(group)
            entries = score_requests(
                [request for _, request in members], jobs=jobs, progress=progress, submitter=submitter
            )
            for (k, request), entry in zip(members, entries, strict=True):
                write_json(self.path(request), entry.model_dump(mode="json"))
                found[k] = entry
            n_done += len(members)
            if progress:
                gone = time.monotonic() - started
                left = gone / n_done * (len(missing) - n_done)
                card = members[0][1].card
                _say(
                    f"{n_done} of {len(missing)} scored ({card.name}); {gone / 60:.1f} min gone, "
                    f"about {left / 60:.0f} min left."
                )
        return [entry for entry in found if entry is not None]


def content_key(request: Request) -> str:
    """sha256 of what the numbers of an entry depend on."""
    explainer, found, card = request.explainer.explainer, request.explainer, request.card
    content: dict[str, Any] = {
        "schema": SCHEMA_VERSION,
        "protocol": PROTOCOL,
        "definitions": DEFINITIONS,
        "policy": card.model_dump(mode="json", exclude={"training", "performance"}),
        "explainer": {
            "name": explainer.name,
            "distribution": found.distribution,
            "version": found.version,
            "entry_point": found.entry_point,
            "code": code_sha256(found),
            **{name: getattr(explainer, name) for name in DECLARED},
            "hyperparameters": dict(explainer.hyperparameters),
        },
        "harness": package_version("xmarl-bench"),
        "sampling": asdict(request.sampling),
        "cells": [[asdict(cell), request.behaviours(cell)] for cell in request.cells],
    }
    return hashlib.sha256(canonical_json(content)).hexdigest()


def code_sha256(found: FoundExplainer) -> str | None:
    """Of the file that the explainer's entry point names; None where there is no such file."""
    if found.code_sha256 is not None:  # it came from a file on the command line, which is no module
        return found.code_sha256
    module = sys.modules.get(found.entry_point.partition(":")[0])
    source = Path(str(getattr(module, "__file__", "")))
    return hashlib.sha256(source.read_bytes()).hexdigest() if source.is_file() else None


def _world(request: Request) -> tuple[str, tuple[Any, ...]]:
    return request.card.name, request.cells


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
