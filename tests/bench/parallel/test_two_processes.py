"""Two processes give what one gives. In one file, because its workers import torch for all of these tests."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

import pytest
import torch
from xmarl_envs import TASKS

from tests.bench.checks.test_explainer_checks import PROCESS, attended, failed
from tests.bench.dataset.test_dataset import exported
from tests.bench.origin.test_references import CODE
from tests.bench.scoring.test_policy_payload import work
from tests.bench.scoring.test_score import bytes_of
from tests.bench.tasks.test_scored import HERE, spread_policy
from tests.conftest import MakeBundle, RunCli, save_bundle
from tests.helpers import units_of_work
from tests.helpers.policies import small_policy
from xmarl_bench import as_explainer, score
from xmarl_bench.entry.file import read_entries
from xmarl_bench.parallel.fan_out import in_order
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import load_policy, save_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score_requests
from xmarl_bench.submission.packing import as_submitted, bundle_files, write_bundle
from xmarl_bench.tasks import sources

pytestmark = pytest.mark.slow
TWO = Workers(2)


def test_each_worker_loads_a_policy_once(tmp_path: Path) -> None:
    policy = small_policy(6)
    units = [work(policy, str(tmp_path)) for _ in range(12)]
    loaded = list(in_order(units_of_work.loaded, units, workers=TWO))
    assert len(loaded) == 12
    processes = {process for process, _ in loaded}  # two, and those that loky replaced one with
    assert 2 <= len(processes) < 12
    assert len(set(loaded)) == len(processes)


def test_entries_have_the_same_bytes(make_bundle: MakeBundle) -> None:
    policies = [load_policy(make_bundle(task, name=task)) for task in sorted(TASKS)]
    fast, few = Sampling(episodes=3, max_cycles=10), Sampling(episodes=2, timesteps=1, max_cycles=10)
    requests = [
        Request(policy, card, find_explainer("attention"), (Cell(card.task, 3),), fast)
        for policy, card in policies
    ]
    requests += [
        Request(*policies[0], find_explainer(name), requests[0].cells, few, behaviour_episodes=0)
        for name in ("gnn_explainer", "graphmask-pyg")
    ]
    one = [bytes_of(entry) for entry in entries_of(score_requests(requests))]
    two = entries_of(score_requests(requests, workers=TWO, parallel_episodes=1))
    assert [bytes_of(entry) for entry in two] == one


def test_a_file_s_explainers_on_a_task_of_others_give_the_same_bytes(
    run_cli: RunCli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "_opened", {})
    file, bundle = tmp_path / "own.py", tmp_path / "spreader"
    file.write_text(CODE)
    policy, card = spread_policy()
    save_policy(bundle, policy, **card)
    few = ("--episodes", 2, "--timesteps", 2, "--max-cycles", 6, "--behaviour-episodes", 0, "--trust-code")
    explainers = ("--explainer", f"{file}:nearest", "--explainer", f"{file}:half")
    made = []
    for jobs in (1, 2):
        where = ("--out", tmp_path / f"out{jobs}", "--cache", tmp_path / f"cache{jobs}", "--jobs", jobs)
        ran = run_cli("score", "--policy", bundle, "--task", f"{HERE}:spread", *explainers, *few, *where)
        assert ran.code == 0, ran.err
        made.append([bytes_of(entry) for _, entry in read_entries(tmp_path / f"out{jobs}" / "entries")])
    assert made[0] == made[1]
    assert len(made[0]) == 2


def test_verdicts_are_the_same(run_cli: RunCli, make_bundle: MakeBundle, tmp_path: Path) -> None:
    folder, path = make_bundle(), tmp_path / "bundle.zip"
    entries = [
        as_submitted(score(folder, name, episodes=2, max_cycles=6), "somebody", None)
        for name in ("attention", "occlusion")
    ]
    write_bundle(path, bundle_files(entries, {"small": folder}, submitter="somebody", licence=b"Yes.\n"))
    one, two = (run_cli("verify", path, "--tier", "full", "--jobs", jobs, "--json").out for jobs in (1, 2))
    assert one == two
    assert len(json.loads(one)) == 2


def test_datasets_have_the_same_bytes(run_cli: RunCli, tmp_path: Path) -> None:
    folder = save_bundle(tmp_path)
    assert exported(folder, tmp_path / "a", run_cli) == exported(folder, tmp_path / "b", run_cli, "--jobs", 2)


def test_datasets_of_a_task_of_others_have_the_same_bytes(
    run_cli: RunCli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "_opened", {})
    policy, card = spread_policy()
    save_policy(tmp_path / "spreader", policy, **card | {"name": "small"})
    task = ("--task", f"{HERE}:spread", "--trust-code")
    one, two = (
        exported(tmp_path / "spreader", tmp_path / f"{jobs}", run_cli, *task, "--jobs", jobs)
        for jobs in (1, 2)
    )
    assert one == two


def test_the_check_of_explainers_compares_the_mask_of_another_process() -> None:
    assert failed(attended, PROCESS) == {}
    by_process = as_explainer(lambda observations: torch.full((len(observations), 3, 3), 1 / os.getpid()))
    assert "the mask differs in another process" in failed(by_process, PROCESS)[PROCESS]
    lock = threading.Lock()
    unsendable = as_explainer(lambda observations: observations @ observations.mT * lock.locked())
    assert "cannot be sent to a worker process" in failed(unsendable, PROCESS)[PROCESS]
