"""One training run in one folder: checkpoints, resume, and at the end a policy bundle.

    RUN/settings.json        what is trained; a run is resumed only with the same settings
    RUN/checkpoint.zip       SB3's zip of weights and optimiser
    RUN/progress.json        frames and CPU seconds so far
    RUN/curve.json           results on the validation episodes along training
    RUN/validated/           weights at these moments; the best become the bundle
    RUN/tensorboard/         SB3's log
    RUN/policy/              the finished bundle (policy.safetensors, policy.json)

Resuming reads weights and optimiser only (SB3's `set_parameters` loads tensors, not pickles) and draws new
random numbers from (seed, frames): a resumed run is as good as an uninterrupted one, but not identical to it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from xmarl_envs import make_task

from xmarl_baselines.training.mappo import MAPPO, IterationCallback
from xmarl_baselines.training.model_selection import ModelSelection, Record
from xmarl_baselines.training.recipes import Recipe
from xmarl_baselines.training.run_files import damaged, read_run_file
from xmarl_baselines.training.team_vec_env import TeamVecEnv
from xmarl_bench.errors import InputError
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.policy.build import untrained_policy
from xmarl_bench.policy.device import CPU
from xmarl_bench.records.files import write_json
from xmarl_bench.rollout.cell import Cell

VALIDATIONS = 10  # per run
Report = Callable[[int, dict[str, float]], None]  # frames so far, SB3's log of the last iteration


@dataclass(frozen=True)
class Run:
    """What is trained.

    `attention_entropy` is lambda of the attention-entropy term. `caution` multiplies the recipe's penalties
    for touching and for being near.
    """

    recipe: Recipe
    n_agents: int = 3
    attention_entropy: float = 0.0
    seed: int = 0
    caution: float = 1.0
    start_from: str | None = None  # name of the finished run whose weights this one starts from

    @property
    def name(self) -> str:
        short = self.recipe.task.removeprefix("blind_").rsplit("_", 1)[0]
        kind = self.recipe.variant or self.recipe.family
        caution = "" if self.caution == 1.0 else f"-caution{self.caution:g}"
        return f"{short}-n{self.n_agents}-{kind}-lambda{self.attention_entropy:g}{caution}-seed{self.seed}"

    @property
    def regularised_from(self) -> float:
        """Frames after which lambda has its full weight."""
        share = self.recipe.attention_start + self.recipe.attention_ramp
        return share * self.recipe.frames if self.attention_entropy else 0.0

    def settings(self) -> dict[str, Any]:
        """As plain JSON, for settings.json and the policy's card."""
        record: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        record["recipe"] = record.pop("recipe")  # last in the card
        return record

    @classmethod
    def from_settings(cls, record: Mapping[str, Any]) -> Run:
        """The run that `settings` wrote. What an older trainer did not write of the recipe has its default.

        Other fields of `record` are ignored. Raises InputError if the recipe is of another version, KeyError
        if a field is missing.
        """
        recipe = Recipe.from_dict(record["recipe"])
        return cls(recipe, **{each.name: record[each.name] for each in fields(cls) if each.name != "recipe"})


@dataclass(frozen=True)
class Trained:
    """The result of a finished run."""

    policy: GraphPolicy
    frames: int  # whole iterations: the recipe's, or a few more
    seconds: float
    validation: Record  # of that policy
    curve: list[Record]  # of all validations


def train(
    run: Run,
    folder: Path,
    *,
    resume: bool = False,
    start_from: Path | None = None,
    checkpoint_every: int = 10,
    report: Report | None = None,
    device: str = CPU,
) -> Trained:
    """Train to the end of the recipe; returns the best policy on the validation episodes.

    start_from: folder of the finished run that `run.start_from` names; its weights and optimiser are read.
    checkpoint_every: iterations between checkpoints. device: of torch, see `checked_device`. Raises
    InputError if `folder` holds another run, or if it holds this one and `resume` is not set.
    """
    model, frames, seconds = begin(
        run, folder, resume=resume, start_from=start_from, tensorboard=folder / "tensorboard", device=device
    )
    cell = Cell(run.recipe.task, run.n_agents)
    every = max(1, run.recipe.frames // VALIDATIONS)
    selection = ModelSelection(folder, cell, every=every, after=run.regularised_from)
    checkpoints = Checkpoints(folder, checkpoint_every, seconds, report)
    if frames < run.recipe.frames:
        model.learn(
            run.recipe.frames - frames,
            callback=[_Caution(run.recipe.caution_growth, run.recipe.frames), selection, checkpoints],
            reset_num_timesteps=frames == 0,
            tb_log_name=run.name,
        )
        selection.validate()
        checkpoints.save()
        seconds = checkpoints.seconds
    else:
        selection.init_callback(model)
    policy, validation = selection.best()
    return Trained(policy, model.num_timesteps, seconds, validation, selection.curve())


def begin(
    run: Run,
    folder: Path,
    *,
    resume: bool,
    start_from: Path | None = None,
    tensorboard: Path | None = None,
    device: str = CPU,
) -> tuple[MAPPO, int, float]:
    """The learner at the last checkpoint in `folder`, or at its beginning; frames and CPU seconds so far.

    Arguments and errors are those of `train`.
    """
    done = _progress(run, folder, resume)
    frames, seconds = done or (0, 0.0)
    model = build(run, seed=run.seed + frames, tensorboard=tensorboard, device=device)
    if done is not None:
        _restore(model, folder / "checkpoint.zip")
        model.num_timesteps = frames
    elif start_from is not None:
        _restore(model, start_from / "checkpoint.zip")
    return model, frames, seconds


def build(run: Run, *, seed: int, tensorboard: Path | None = None, device: str = CPU) -> MAPPO:
    """The untrained learner of a run."""
    recipe = run.recipe
    task = make_task(recipe.task, run.n_agents)
    shaping = recipe.shaping.with_caution(run.caution)
    env = TeamVecEnv(task, recipe.n_envs, seed=seed, shaping=shaping, max_cycles=recipe.max_cycles)
    model = MAPPO(
        "TeamPolicy",
        env,
        learning_rate=recipe.learning_rate_at,
        n_steps=recipe.n_steps,
        batch_size=recipe.batch_size,
        n_epochs=recipe.n_epochs,
        gamma=recipe.gamma,
        gae_lambda=recipe.gae_lambda,
        clip_range=recipe.clip_range,
        normalize_advantage=recipe.normalize_advantage,
        ent_coef=recipe.ent_coef,
        vf_coef=1.0,
        max_grad_norm=recipe.max_grad_norm,
        attention_entropy=run.attention_entropy,
        attention_ramp=recipe.attention_ramp,
        attention_start=recipe.attention_start,
        saturation_penalty=recipe.saturation_penalty,
        saturation_deviations=recipe.saturation_deviations,
        policy_kwargs={"architecture": recipe.architecture, "critic": recipe.critic},
        tensorboard_log=None if tensorboard is None else str(tensorboard),
        device=device,
        seed=seed,
    )
    # The weights that `xmarl_bench.policy.initial_policy` rebuilds from the card.
    initial = untrained_policy(model.policy.actor.architecture, run.seed)
    model.policy.actor.load_state_dict(initial.state_dict())
    return model


def _progress(run: Run, folder: Path, resume: bool) -> tuple[int, float] | None:
    """Frames and seconds at the last checkpoint in `folder`, or None; writes the settings of a new run."""
    settings, progress = folder / "settings.json", folder / "progress.json"
    if not settings.exists():
        write_json(settings, run.settings())
        return None
    if read_run_file(settings, Run.from_settings) != run:
        raise InputError(f"{folder} holds a run with other settings: choose another --out, or remove it.")
    if not resume:
        raise InputError(f"{folder} holds this run already: add --resume to go on with it, or remove it.")
    if not progress.exists():
        return None
    return read_run_file(progress, lambda done: (int(done["frames"]), float(done["seconds"])))


def _restore(model: MAPPO, checkpoint: Path) -> None:
    """Set weights and optimiser. Raises InputError if the file is not a checkpoint of such a model."""
    try:
        model.set_parameters(str(checkpoint), device=model.device)
    except OSError:
        raise
    except Exception as error:  # of zipfile, pickle or torch
        raise damaged(checkpoint) from error


class _Caution(IterationCallback):
    """Multiplies the penalties for touching and for being near, linearly from 1 to `growth` over the run."""

    def __init__(self, growth: float, frames: int) -> None:
        super().__init__()
        self._growth, self._frames = growth, frames

    def _on_rollout_start(self) -> None:
        # SB3 keeps this number, but not over a resume. Subtracted twice, as from SB3's: the same bits.
        remaining = 1.0 - self.model.num_timesteps / self._frames
        done = min(1.0, 1.0 - remaining)
        self.training_env.set_attr("caution", 1.0 + (self._growth - 1.0) * done)


class Checkpoints(IterationCallback):
    """Saves a checkpoint after every few iterations, and reports progress after each.

    seconds: of CPU time before.
    """

    def __init__(self, folder: Path, every: int, seconds: float, report: Report | None = None) -> None:
        super().__init__()
        self._folder, self._every, self._report = folder, every, report
        self._earlier, self._started = seconds, time.process_time()
        self._iterations = 0

    @property
    def seconds(self) -> float:
        return self._earlier + time.process_time() - self._started

    def _on_rollout_start(self) -> None:  # the previous iteration's update is done
        self._iterations += 1
        if self._report is not None:
            self._report(self.num_timesteps, dict(self.logger.name_to_value))
        if self._iterations % self._every == 0:
            self.save()

    def save(self) -> None:
        """Write the checkpoint before the progress: a kill between the two repeats frames but loses none."""
        self.model.save(self._folder / "checkpoint.new.zip")
        (self._folder / "checkpoint.new.zip").replace(self._folder / "checkpoint.zip")
        write_json(
            self._folder / "progress.json", {"frames": self.model.num_timesteps, "seconds": self.seconds}
        )
