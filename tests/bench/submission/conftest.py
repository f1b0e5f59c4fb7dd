"""One small measured score, from which tests make entries and bundles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.policies import small_policy
from xmarl_bench.entry.schema import Entry
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import load_policy, save_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score_requests
from xmarl_bench.submission.packing import as_submitted, bundle_files, write_bundle

TASK, TEAM = "blind_passage_v0", 3
LICENCE = b"Anyone may use this.\n"
Pack = Callable[..., Path]


@pytest.fixture(scope="session")
def policy_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policies") / "small"
    save_policy(
        folder,
        small_policy(8),
        name="small",
        task=TASK,
        n_agents=TEAM,
        attention_entropy=0.5,
        training_seed=0,
    )
    return folder


@pytest.fixture(scope="session")
def entries(policy_folder: Path) -> list[Entry]:
    """Entries of two explainers on seven episodes, five of them also played on the explanation."""
    policy, card = load_policy(policy_folder)
    requests = [
        Request(policy, card, find_explainer(name), (Cell(TASK, TEAM),), Sampling(7, None, 8), 5)
        for name in ("attention", "occlusion")
    ]
    return [as_submitted(entry, "somebody", None) for entry in entries_of(score_requests(requests))]


@pytest.fixture(scope="session")
def files(entries: list[Entry], policy_folder: Path) -> Mapping[str, bytes]:
    return bundle_files(entries, {"small": policy_folder}, submitter="somebody", licence=LICENCE)


@pytest.fixture
def pack(tmp_path: Path) -> Pack:
    """pack(files, "name.zip") -> the path of the bundle; a folder if the name has no .zip."""

    def write(files: Mapping[str, bytes], name: str = "bundle.zip") -> Path:
        write_bundle(tmp_path / name, files)
        return tmp_path / name

    return write


def value_of(entry: Entry) -> dict[str, Any]:
    value: dict[str, Any] = entry.model_dump(mode="json")
    return value
