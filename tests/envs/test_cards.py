"""Cards: a task's docstring, its section in envs/README.md and its constants agree."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from xmarl_envs import TASKS, Task, TaskParallelEnv, make_task

FOLDER = Path(__file__).parent.parent.parent / "envs"
README = (FOLDER / "README.md").read_text(encoding="utf-8")
tasks = pytest.mark.parametrize("name", TASKS)


def card(name: str) -> list[str]:
    """The rows of the table in the task's docstring."""
    text = sys.modules[TASKS[name].__module__].__doc__ or ""
    return [line for line in text.splitlines() if line.startswith("|")]


def section(name: str) -> str:
    (found,) = re.findall(rf"^## {name}$(.*?)^## ", README, flags=re.MULTILINE | re.DOTALL)
    return str(found)


def said(name: str, row: str) -> str:
    """A row of the card, e.g. "Reward"."""
    (found,) = [line for line in card(name) if line.startswith(f"| {row} |")]
    return found


@tasks
def test_the_page_contains_the_card_and_a_picture(name: str) -> None:
    assert "\n".join(card(name)) in section(name)
    assert f"](../docs/{name}.png)" in section(name)
    assert f"| Differs from VMAS `{name.split('_')[1]}` | Why |" in section(name)


@tasks
def test_the_card_states_the_constants(name: str) -> None:
    task: Task = make_task(name)
    assert f"1 <= N <= {task.max_agents}" in said(name, "Agents")
    assert f"radius {task.radius:g} m and mass 1 kg" in said(name, "Agents")
    assert ("times" in said(name, "Action")) == (task.u_mult != 1)
    assert task.u_mult == 1 or f"times {task.u_mult:g}: force in newton" in said(name, "Action")
    assert f"within {task.collision_gap:g} m" in said(name, "Collision")
    assert f"truncated after {task.default_max_cycles} cycles of 0.1 s" in said(name, "Done")
    for constant in ("spawn_spacing", "spacing"):
        if hasattr(task, constant):
            assert f" {getattr(task, constant):g} m" in said(name, "Start")
    for constant in ("distance_reward", "collision_penalty", "all_at_goal_reward", "found_reward"):
        if hasattr(task, constant):
            assert re.search(rf"\b{getattr(task, constant):g}\b", said(name, "Reward"))
    reached = {
        "blind_navigation_v0": "goal_radius",
        "blind_passage_v0": "radius",
        "blind_discovery_v0": "covering_range",
    }[name]
    distance = getattr(task, reached) / (2 if name == "blind_passage_v0" else 1)
    assert f"within {distance:g} m" in said(name, "Done")


@tasks
def test_the_card_states_spaces_and_infos(name: str) -> None:
    env = TaskParallelEnv(make_task(name))
    env.reset(seed=0)
    space = str(env.observation_space("agent_0"))
    assert said(name, "Observation").startswith(f"| Observation | {space}: ")
    action = str(env.action_space("agent_0")).replace("1.0", "1")
    assert said(name, "Action").startswith(f"| Action | {action}")
    infos = env.step({agent: env.action_space(agent).sample() for agent in env.agents})[-1]
    assert re.findall(r"`(\w+)`", said(name, "Info")) == list(infos["agent_0"])


def test_links_lead_to_files_and_code_runs() -> None:
    for link in re.findall(r"\]\((?!https?:)([^)#]+)", README):
        assert (FOLDER / link).exists(), link
    for path in re.findall(r"`(tests/[\w./]+)`", README):
        assert (FOLDER.parent / path).exists(), path
    blocks = re.findall(r"^```python\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
    assert blocks
    for code in blocks:
        exec(compile(code, "envs/README.md", "exec"), {"__name__": "readme"})
