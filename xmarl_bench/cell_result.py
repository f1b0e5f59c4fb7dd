"""Puts a cell's results together from the work that is done: rows, their means, and the controls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import torch
from xmarl_envs import TASKS

from xmarl_bench.behaviour import Played
from xmarl_bench.controls import INVERTED, RANDOM
from xmarl_bench.entry import CellResult, ControlMetrics, Cost, EpisodeRow
from xmarl_bench.errors import InputError
from xmarl_bench.measure import Explained, Measured
from xmarl_bench.not_measured import not_measured
from xmarl_bench.request import Cell, Request
from xmarl_bench.rollout import Episode, mean_metrics
from xmarl_bench.states import Values, number
from xmarl_bench.summary import BEHAVIOUR, SANITY, cell_metrics, control_metrics
from xmarl_bench.work import Behaviours, Episodes, Key, Result, States, world_of

Kind = TypeVar("Kind")


@dataclass
class Done:
    """What workers have returned so far."""

    episodes: Episodes
    results: dict[Key, list[Result]] = field(default_factory=dict)
    # The means of controls that many entries share: key, episodes, behaviour episodes.
    controls: dict[tuple[Key, int, int], dict[str, ControlMetrics]] = field(default_factory=dict)

    def measured(self, request: Request, cell: Cell) -> list[Measured]:
        key = States(world_of(request, cell), request.sampling.timesteps)
        return [_or_raise(each, Measured) for each in self.results[key][: request.sampling.episodes]]

    def explained(self, request: Request, cell: Cell) -> list[Explained]:
        """Raises the InputError of the explainer's first episode that went wrong."""
        name = request.explainer.explainer.name
        return [_or_raise(each.explained[name], Explained) for each in self.measured(request, cell)]

    def played(self, request: Request, cell: Cell, explainer: str | None) -> list[Played]:
        """Blocks of episodes, as many as there are; none where the request asks for none."""
        if not request.behaviours(cell):
            return []
        key = Behaviours(world_of(request, cell), explainer)
        return [_or_raise(each, Played) for each in self.results[key]]

    def behaviours(self, request: Request, cell: Cell, explainer: str | None) -> list[Values]:
        """Of `BehaviourRow`, for each of the request's episodes."""
        values = [each for block in self.played(request, cell, explainer) for each in block.values]
        n_played = request.behaviours(cell)
        missing = request.sampling.episodes - n_played
        return values[:n_played] + [dict.fromkeys(BEHAVIOUR)] * missing


def cell_result(request: Request, cell: Cell, done: Done) -> CellResult:
    """Raises InputError where the explainer failed on an episode."""
    sampling, world = request.sampling, world_of(request, cell)
    episodes = done.episodes[world][: sampling.episodes]
    measured, explained = done.measured(request, cell), done.explained(request, cell)
    reasons = not_measured(request, cell, torch.tensor(episodes[0].observations[:1]))
    n_played = request.behaviours(cell)
    rows = tuple(
        episode_row(cell, *parts)
        for parts in zip(
            episodes,
            measured,
            explained,
            done.behaviours(request, cell, request.explainer.explainer.name),
            strict=True,
        )
    )
    shared = (States(world, sampling.timesteps), sampling.episodes, n_played)
    if shared not in done.controls:
        done.controls[shared] = _controls(request, cell, done, measured, reasons)
    inverted = control_metrics([each.inverted for each in explained], sampling.seed, reasons, 0)
    return CellResult(
        task=cell.task,
        n_agents=cell.n_agents,
        max_cycles=sampling.max_cycles or TASKS[cell.task].default_max_cycles,
        metrics=cell_metrics(rows, sampling.seed, reasons, n_played),
        not_measured=reasons,
        controls={**done.controls[shared], INVERTED: inverted},
        behaviour_episodes=n_played,
        episodes=rows,
    )


def episode_row(
    cell: Cell, episode: Episode, measured: Measured, explained: Explained, behaviour: Values
) -> EpisodeRow:
    """What an entry keeps of one episode. behaviour: of `BehaviourRow`, null where it was not played so."""
    return EpisodeRow.model_validate(
        {
            "seed": episode.seed,
            "length": len(episode.observations),
            "timesteps": measured.timesteps,
            **dict.fromkeys(SANITY),
            **explained.values,
            **explained.budgets,
            **behaviour,
            **measured.policy,
            **_task_values(cell, episode),
        }
    )


def cost_of(request: Request, done: Done) -> Cost:
    measured = [unit for cell in request.cells for unit in done.measured(request, cell)]
    explained = [each for cell in request.cells for each in done.explained(request, cell)]
    name = request.explainer.explainer.name
    played = [block for cell in request.cells for block in done.played(request, cell, name)]
    timesteps = sum(unit.timesteps for unit in measured)
    return Cost(
        explain_seconds_per_timestep=sum(each.seconds for each in explained) / timesteps,
        explained_timesteps=timesteps,
        shared_seconds_per_timestep=sum(unit.shared_seconds for unit in measured) / timesteps,
        behaviour_seconds=sum(block.seconds for block in played),
    )


def _controls(
    request: Request, cell: Cell, done: Done, measured: Sequence[Measured], reasons: Mapping[str, str]
) -> dict[str, ControlMetrics]:
    """All but the inverted mask, which is the explainer's own."""
    rows: dict[str, list[Values]] = {
        name: [unit.controls[name] for unit in measured] for name in measured[0].controls
    }
    if request.behaviours(cell):
        behaviours = done.behaviours(request, cell, None)
        rows[RANDOM] = [{**row, **more} for row, more in zip(rows[RANDOM], behaviours, strict=True)]
    n_played = request.behaviours(cell)
    return {
        name: control_metrics(each, request.sampling.seed, reasons, n_played) for name, each in rows.items()
    }


def _task_values(cell: Cell, episode: Episode) -> Values:
    means = mean_metrics(cell.task, [episode])
    return {name: None if value is None else number(value) for name, value in means.items()}


def _or_raise(result: object, kind: type[Kind]) -> Kind:
    if isinstance(result, InputError):
        raise result
    assert isinstance(result, kind)
    return result
