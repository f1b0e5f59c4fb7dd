"""The paper's own schedule with its weight of the attention-entropy term, whole or its first iterations.

Kailas et al. (ICML 2025, appendix) train with lambda 10, 50 and 50. Each run here trains that schedule from
scratch, with and without lambda, with advantages normalised as in the paper's table and the other way round.
Nothing decays in the schedule, so a short run is the beginning of the whole one.

    python -m xmarl_baselines.paper_lambda navigation-n3-schedule-lambda10-seed0 --iterations 15

writes baselines/xmarl_baselines/controls/paper_lambda/NAME.json, shown in baselines/README.md. After an
interruption the same command goes on, and one with more iterations goes on after those that are there:
RUNS/NAME keeps checkpoints (trainer.py) and attention.json. `xmarl-train --reproduce NAME` trains and
validates the whole schedule.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
import typer
from numpy.typing import NDArray

from xmarl_baselines.independent_ppo import CONTROLS
from xmarl_baselines.reference import run_named
from xmarl_baselines.training.mappo import IterationCallback
from xmarl_baselines.training.model_selection import plain_actor
from xmarl_baselines.training.run_files import damaged, read_run_file
from xmarl_baselines.training.trainer import Checkpoints, Run, begin
from xmarl_bench.cli.program import run_function
from xmarl_bench.errors import InputError
from xmarl_bench.metrics import attention_entropy, prediction_change
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.records.files import write_json
from xmarl_bench.reproducible import one_thread
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.rollout.evaluation import evaluate_policy

RECORDS = CONTROLS / "paper_lambda"
STATES = Sampling(episodes=20)  # the first that scoring plays, every timestep, measured after training
EPISODES, CHECKPOINT_EVERY = 100, 5  # of the evaluation; iterations
AttentionRecord = dict[str, float | None]


def own_share(attention: NDArray[np.floating]) -> float:
    """(S, N, N) attention -> mean share of an agent's attention that is on its own edge, in [0, 1]."""
    return float(np.diagonal(attention, axis1=-2, axis2=-1).mean())


def most_heard(attention: NDArray[np.floating]) -> float:
    """(S, N, N) attention -> mean share of the team's attention on the agent that gets most of it.

    1 / N if agents hear themselves or all alike, 1 if everybody hears the same agent.
    """
    return float(attention.mean(axis=-2).max(axis=-1).mean())


class _Attention(IterationCallback):
    """Records and prints the attention on the states of each iteration, before the update on them.

    records: of the iterations before. `file` gets all of them after each iteration.
    """

    def __init__(self, name: str, file: Path, records: list[AttentionRecord]) -> None:
        super().__init__()
        self._name, self._file, self.records = name, file, records

    def _on_rollout_end(self) -> None:
        seen = torch.from_numpy(self.model.rollout_buffer.observations).flatten(0, 1)
        with torch.no_grad():
            attention = self.model.policy.actor.attention(seen).numpy()
        ended = [row["is_success"] for row in self.model.ep_info_buffer or []]
        record: AttentionRecord = {
            "frames": self.model.num_timesteps - len(seen),  # trained on so far
            "attention_entropy": float(attention_entropy(attention).mean()),
            "own_share": own_share(attention),
            "success_while_exploring": float(np.mean(ended)) if ended else None,
        }
        self.records.append(record)
        write_json(self._file, self.records)
        print(self._name, record, flush=True)


class Schedule(NamedTuple):
    """The first iterations of a schedule."""

    policy: GraphPolicy  # after them
    along: list[AttentionRecord]  # on the states of each
    seconds: float  # of CPU time


def first_iterations(run: Run, iterations: int, folder: Path) -> Schedule:
    """Train them, from the last checkpoint in `folder` if there is one.

    Raises InputError if `folder` holds another run, or more iterations of this one.
    """
    each = run.recipe.n_envs * run.recipe.n_steps
    model, frames, seconds = begin(run, folder, resume=True)
    if frames > iterations * each:
        raise InputError(
            f"{folder} holds {frames // each} iterations of this run already: choose at least as many, or "
            f"other --runs."
        )
    file = folder / "attention.json"
    known: list[AttentionRecord] = read_run_file(file, list) if file.exists() else []
    along = known[: frames // each]
    if len(along) * each != frames:
        raise damaged(file)
    recorder = _Attention(run.name, file, along)
    checkpoints = Checkpoints(folder, CHECKPOINT_EVERY, seconds)
    if frames < iterations * each:
        missing = iterations * each - frames
        model.learn(missing, callback=[recorder, checkpoints], reset_num_timesteps=frames == 0)
        checkpoints.save()
    return Schedule(plain_actor(model), recorder.records, checkpoints.seconds)


@torch.inference_mode()
def listening(policy: GraphPolicy, task: str, n_agents: int) -> dict[str, float]:
    """Attention and communication dependence on deterministic episodes: means of means, as in scoring.

    Attention: entropy (nats) and shares. Communication dependence: how far the action moves, in [-1, 1]
    units, when all messages between agents are removed.
    """
    rows = []
    for episode in roll_out(Cell(task, n_agents).make(), policy, STATES.seeds, max_cycles=STATES.max_cycles):
        seen = torch.tensor(episode.observations)
        attention = policy.attention(seen).numpy()
        full, alone = (policy.distribution(seen, mask).action.numpy() for mask in (None, torch.eye(n_agents)))
        change = prediction_change(full, alone)
        entropy = attention_entropy(attention)
        rows.append((entropy.mean(), own_share(attention), most_heard(attention), change.mean()))
    names = ("attention_entropy", "own_share", "most_heard", "communication_dependence")
    return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))


def main(
    name: Annotated[str, typer.Argument(help="e.g. navigation-n3-schedule-lambda10-seed0")],
    iterations: Annotated[int, typer.Option(min=1, help="of the paper's schedule")],
    episodes: Annotated[int, typer.Option(min=1, help="of the evaluation at the end")] = EPISODES,
    out: Annotated[Path, typer.Option(help="folder for NAME.json")] = RECORDS,
    runs: Annotated[Path, typer.Option(help="folder for checkpoints")] = Path("runs/schedules"),
) -> None:
    """Train the first iterations of one of the paper's schedules and record its attention."""
    run = run_named(name)
    recipe = run.recipe
    with one_thread():
        policy, along, seconds = first_iterations(run, iterations, runs / name)
        record: dict[str, Any] = {
            "name": name,
            "command": f"python -m xmarl_baselines.paper_lambda {name} --iterations {iterations}"
            + ("" if episodes == EPISODES else f" --episodes {episodes}"),
            "task": recipe.task,
            "n_agents": run.n_agents,
            "lambda": run.attention_entropy,
            "normalize_advantage": recipe.normalize_advantage,
            "iterations": iterations,
            "frames": iterations * recipe.n_envs * recipe.n_steps,
            "frames_of_the_schedule": recipe.frames,
            "cpu_seconds": round(seconds, 1),
            "along": along,
            "listening": listening(policy, recipe.task, run.n_agents),
            "performance": evaluate_policy(policy, recipe.task, run.n_agents, episodes=episodes),
        }
    write_json(out / f"{name}.json", record)
    print(f"{out / f'{name}.json'}: {record['listening']}")


if __name__ == "__main__":
    run_function(main, "stopped; the same command goes on.")
