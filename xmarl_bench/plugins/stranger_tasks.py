"""The task in the process of a stranger's code: opens it, and steps its episodes."""

from __future__ import annotations

import pickle
from dataclasses import asdict
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
from xmarl_envs import Step

from xmarl_bench.origin.code_hash import object_sha256
from xmarl_bench.origin.plugins import load_plugin, origin_of_plugin
from xmarl_bench.tasks.interface import TeamEpisodes, TeamTask
from xmarl_bench.tasks.sources import TaskSource, open_factory, open_task

Answer = tuple[dict[str, Any], bytes]
ARRAYS = Step._fields[1:]  # the observation goes first, in its own type
FLAGS = ("terminated", "truncated")


class Tasks:
    """The task that the harness plays, and its episodes by number."""

    def __init__(self) -> None:
        self.source: TaskSource | None = None
        self.episodes: dict[str, TeamEpisodes] = {}

    def answer(self, question: dict[str, Any]) -> Answer:
        if question["what"] == "task":
            self.source = _opened(question)
            return told(self.source), b""
        task = self._task(question["n_agents"], question["continuous"])
        if question["what"] == "make":
            return self._told_of(task), b""
        for ended in question["ended"]:
            self.episodes.pop(ended, None)
        if question["what"] == "reset":
            return {}, self._reset(task, question)
        step = self.episodes[question["number"]].step(question["action"], question["live"])
        arrays = [
            np.asarray(getattr(step, name), dtype="?" if name in FLAGS else "<f8").tobytes()
            for name in ARRAYS
        ]
        return {}, _observed(step.observation) + b"".join(arrays)

    def _task(self, n_agents: int, continuous: bool | None) -> TeamTask:
        assert self.source is not None
        task = self.source.make(n_agents)
        return task if continuous is None else task.with_actions(continuous)

    def _told_of(self, task: TeamTask) -> dict[str, Any]:
        assert self.source is not None
        return {
            "obs_dim": task.obs_dim,
            "observation_names": list(task.observation_names),
            "continuous_actions": task.continuous_actions,
            "action_width": task.action_width,
            "default_max_cycles": task.default_max_cycles,
            "has_objects": task.has_objects,
            "environment": asdict(self.source.environment(task.n_agents)),
        }

    def _reset(self, task: TeamTask, question: dict[str, Any]) -> bytes:
        number = question["number"]
        if number not in self.episodes:
            self.episodes[number] = task.vector_env(question["n_episodes"], question["max_cycles"])
        return _observed(self.episodes[number].reset(question["seeds"], question["episodes"]))


def told(source: TaskSource) -> dict[str, Any]:
    """What the harness has to know of a task of others before it makes one."""
    assert source.origin is not None
    return {
        "name": source.name,
        "origin": asdict(source.origin),
        "key": object_sha256(source.factory),
        "observation_names": list(source.observation_names),
    }


def _opened(question: dict[str, Any]) -> TaskSource:
    if "pickled" in question:
        return open_task(pickle.loads(question["pickled"]))
    if "plugin" in question:
        plugin = EntryPoint(*question["plugin"])
        return open_factory(load_plugin(plugin), origin_of_plugin(plugin), plugin.name)
    return open_task(question["reference"], trust_code=True)


def _observed(observation: Any) -> bytes:
    return np.asarray(observation, dtype="<f4").tobytes()
