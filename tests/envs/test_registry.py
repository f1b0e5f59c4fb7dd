"""The registry equals the files on disk, and the environments import nothing of the harness."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest
import xmarl_envs
from xmarl_envs import TASKS, Task, TaskParallelEnv, make_task


def test_the_registry_equals_the_files_on_disk() -> None:
    folder = Path(xmarl_envs.__file__).parent
    assert set(TASKS) == {path.stem for path in folder.glob("blind_*_v*.py")}


@pytest.mark.parametrize("name", TASKS)
def test_a_task_has_one_name(name: str) -> None:
    module = importlib.import_module(f"xmarl_envs.{name}")
    task = make_task(name, 4)
    assert (task.name, task.n_agents) == (name, 4)
    assert type(task).__module__ == f"xmarl_envs.{name}"
    env = module.parallel_env(n_agents=4)
    assert isinstance(env, TaskParallelEnv)
    assert env.metadata["name"] == name
    assert Path(__file__).with_name(f"test_{name}.py").exists()


@pytest.mark.parametrize("name", TASKS)
def test_a_task_s_docstring_is_its_card(name: str) -> None:
    card = importlib.import_module(f"xmarl_envs.{name}").__doc__ or ""
    task: type[Task] = TASKS[name]
    for line in ("Agents", "Action", "Observation", "Start", "Reward", "Collision", "Done"):
        assert f"| {line} |" in card
    assert f"({len(task.observation_names)},)" in card
    assert f"radius {task.radius} m" in card
    assert f"within {task.collision_gap} m" in card
    assert f"after {task.default_max_cycles} cycles" in card


def test_the_error_for_an_unknown_task_lists_the_known_ones() -> None:
    with pytest.raises(
        ValueError, match="unknown task 'blind_chess_v0': choose one of blind_navigation_v0, "
    ):
        make_task("blind_chess_v0")


@pytest.mark.slow
def test_importing_the_environments_prints_nothing_and_imports_neither_torch_nor_physics() -> None:
    code = f"""
import importlib, sys
for name in {["xmarl_envs", *(f"xmarl_envs.{name}" for name in TASKS)]}:
    importlib.import_module(name)
unwanted = {{"torch", "pymunk", "pygame", "xmarl_bench", "xmarl_baselines", "stable_baselines3"}}
unwanted &= set(sys.modules)
assert not unwanted, unwanted
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")
