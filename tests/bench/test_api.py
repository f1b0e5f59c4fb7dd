"""The public API is complete, loads lazily, and names nothing of the baselines."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import xmarl_bench
from tests.conftest import MakeBundle

PACKAGE = Path(xmarl_bench.__file__).parent


def test_the_harness_names_no_explainer_or_policy_of_the_baselines() -> None:
    for file in PACKAGE.rglob("*"):
        if file.suffix in (".py", ".jinja"):
            text = file.read_text()
            # The paper's studies name their explainers, and find them through the registry.
            explainers = () if file.is_relative_to(PACKAGE / "papers") else ("gnn_explainer", "graphmask-pyg")
            for name in ("xmarl_baselines", *explainers):
                assert name not in text, f"{file} names {name}"


@pytest.mark.slow
def test_the_public_api_is_complete_and_lazy() -> None:
    for name in xmarl_bench.__all__:
        assert getattr(xmarl_bench, name) is not None
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = xmarl_bench.no_such_thing
    code = "import sys, xmarl_bench.errors, xmarl_bench.cli.main; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0


@pytest.mark.slow
def test_paths_may_be_text(tmp_path: Path, make_bundle: MakeBundle) -> None:
    policy, card = xmarl_bench.load_policy(str(make_bundle()))
    xmarl_bench.save_policy(
        f"{tmp_path}/copy", policy, name="copy", task=card.task, n_agents=3, attention_entropy=0.0
    )
    entry = xmarl_bench.score(
        f"{tmp_path}/copy", "random", episodes=1, timesteps=1, max_cycles=2, cache=f"{tmp_path}/cache"
    )
    file = xmarl_bench.write_entry(f"{tmp_path}/board/entries", entry)
    assert xmarl_bench.read_entry(str(file)) == entry
    assert xmarl_bench.build_board(f"{tmp_path}/board").is_file()
