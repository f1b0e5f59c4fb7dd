"""Assembles a cell's result from finished pieces: rows, their means, and the controls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain

from xmarl_bench.entry.aggregation import SANITY, Acted, cell_metrics, control_metrics, sampling_error
from xmarl_bench.entry.metric_records import BehaviourRow, ControlMetrics, EpisodeRow, SanityRow
from xmarl_bench.entry.protocol import SAMPLED
from xmarl_bench.entry.schema import CellResult, Cost, OracleRecord
from xmarl_bench.explain.control_names import INVERTED, RANDOM
from xmarl_bench.explain.oracle import oracle_kind
from xmarl_bench.explain.sampled_oracle import ORDERS
from xmarl_bench.metrics.table import GAINS
from xmarl_bench.records.field_types import rounded
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import Episode, mean_metrics
from xmarl_bench.scoring.behaviour import Played
from xmarl_bench.scoring.measure import Explained, Shared
from xmarl_bench.scoring.not_measured import not_measured
from xmarl_bench.scoring.pieces import Needs
from xmarl_bench.scoring.rankings import number
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.results import Results

# Cells whose controls stay in memory for the next entry: explainers of a policy come one after another.
KEPT = 4
NOT_PLAYED = BehaviourRow.model_validate(dict.fromkeys(BehaviourRow.model_fields))
NOT_CHECKED = SanityRow.model_validate(dict.fromkeys(SANITY))


@dataclass
class Controls:
    """Means of the controls, which all explainers of the same states share. Keeps the last few."""

    known: dict[tuple[str, ...], dict[str, ControlMetrics]] = field(default_factory=dict)

    def of(
        self,
        request: Request,
        cell: Cell,
        needed: Needs,
        shared: Sequence[Shared],
        random_behaviour: Sequence[BehaviourRow],
        reasons: Mapping[str, str],
    ) -> dict[str, ControlMetrics]:
        """Means of all controls but the inverted mask, which depends on the explainer."""
        random = (*needed.random_behaviour, *needed.random_absences)
        key = tuple(piece.key for piece in (*needed.shared, *random))
        if key not in self.known:
            played = random_behaviour[: request.behaviours(cell)]
            self.known[key] = {
                name: control_metrics(
                    [each.controls[name] for each in shared],
                    played if name == RANDOM else (),
                    request.sampling.seed,
                    reasons,
                    request.absence_behaviours(cell) if name == RANDOM else 0,
                )
                for name in shared[0].controls
            }
            if len(self.known) > KEPT:
                self.known.pop(next(iter(self.known)))
        return self.known[key]


def cell_result(
    request: Request, cell: Cell, needed: Needs, results: Results, controls: Controls
) -> tuple[CellResult, Cost]:
    """A cell's result and its cost. All its pieces must be complete."""
    sampling = request.sampling
    of_pieces = [[results.get(piece) for piece in pieces] for pieces in needed]
    episodes, mute, shared, explained = (list(chain(*each)) for each in of_pieces[:4])
    played, absences, by_chance, by_chance_absences = of_pieces[4:]
    reasons = not_measured(request, cell, episodes, shared)
    rows = tuple(
        episode_row(cell, *parts)
        for parts in zip(
            episodes, mute, shared, explained, _behaviours(played, absences, len(episodes)), strict=True
        )
    )
    floor = _behaviours(by_chance, by_chance_absences, len(episodes))
    inverted = control_metrics([each.inverted for each in explained], (), sampling.seed, reasons)
    acted = Acted(request.behaviours(cell), request.absence_behaviours(cell))
    result = CellResult(
        task=cell.task,
        n_agents=cell.n_agents,
        max_cycles=sampling.max_cycles or cell.make().default_max_cycles,
        metrics=cell_metrics(rows, sampling.seed, reasons, acted),
        not_measured=reasons,
        controls={**controls.of(request, cell, needed, shared, floor, reasons), INVERTED: inverted},
        behaviour_episodes=acted.zero,
        absence_behaviour_episodes=acted.others,
        oracle=_oracle(request, cell, rows),
        episodes=rows,
    )
    return result, _cost(shared, explained, played + absences)


def _oracle(request: Request, cell: Cell, rows: Sequence[EpisodeRow]) -> OracleRecord | None:
    kind = oracle_kind(request.policy, cell.n_agents)
    if kind == "sampled":
        error = sampling_error(rows)
        return OracleRecord(kind="sampled", orders=ORDERS, error=error, definition=SAMPLED)
    return None if kind is None else OracleRecord(kind=kind)


def total_cost(costs: Sequence[Cost]) -> Cost:
    """The cost of all cells of an entry."""
    n = sum(each.explained_timesteps for each in costs)
    return Cost(
        explain_seconds_per_timestep=rounded(sum(each.explain_seconds for each in costs) / n),
        explained_timesteps=n,
        shared_seconds_per_timestep=rounded(sum(each.shared_seconds for each in costs) / n),
        behaviour_seconds=rounded(sum(each.behaviour_seconds for each in costs)),
    )


def _cost(shared: Sequence[Shared], explained: Sequence[Explained], played: Sequence[Played]) -> Cost:
    timesteps = sum(each.timesteps for each in shared)
    return Cost(
        explain_seconds_per_timestep=sum(each.seconds for each in explained) / timesteps,
        explained_timesteps=timesteps,
        shared_seconds_per_timestep=sum(each.seconds for each in shared) / timesteps,
        behaviour_seconds=sum(each.seconds for each in played),
    )


def _behaviours(played: Sequence[Played], absences: Sequence[Played], episodes: int) -> list[BehaviourRow]:
    """A row for each episode, from its rollouts under zero and the other models; NOT_PLAYED without."""
    under = [
        {name: value for name, value in row if value is not None} for block in absences for row in block.rows
    ]
    rows = [row for block in played for row in block.rows]
    for k, more in enumerate(under):
        rows[k] = rows[k].model_copy(update=more)
    return rows + [NOT_PLAYED] * (episodes - len(rows))


def episode_row(
    cell: Cell,
    episode: Episode,
    mute: Episode,
    shared: Shared,
    explained: Explained,
    behaviour: BehaviourRow,
) -> EpisodeRow:
    """The row of one episode in an entry. mute: the same episode without messages."""
    parts = (explained.row, behaviour, explained.sanity or NOT_CHECKED, shared.policy)
    values = {
        "seed": episode.seed,
        "length": len(episode.observations),
        "timesteps": shared.timesteps,
        **{name: budget.model_dump() for name, budget in explained.budgets.items()},
        **{name: number(getattr(episode, metric) - getattr(mute, metric)) for name, metric in GAINS.items()},
        **{name: value for part in parts for name, value in part},
        **{
            name: None if value is None else number(value)
            for name, value in mean_metrics(cell.make(), [episode]).items()
        },
    }
    return EpisodeRow.model_validate(rounded(values))
