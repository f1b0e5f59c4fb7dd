"""How the reference policies are trained: a recipe per task, and what a team size or family changes of it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

from xmarl_baselines.training.families import Family, architecture
from xmarl_baselines.training.shaping import Shaping
from xmarl_bench.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Recipe:
    """MAPPO's hyperparameters on one task, for one family of networks."""

    task: str
    frames: int  # team-steps
    n_envs: int  # teams stepped together
    n_steps: int  # per team and iteration: an iteration is n_envs * n_steps frames
    n_epochs: int
    batch_size: int  # team-steps per gradient step; the last one of an epoch may be smaller
    learning_rate: float  # at the start; falls linearly to learning_rate * final_learning_rate
    family: Family = "residual"
    critic: tuple[int, ...] = (128, 128)
    final_learning_rate: float = 0.1  # fraction
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    normalize_advantage: bool = True
    ent_coef: float = 1e-4
    saturation_penalty: float = 0.0  # on raw actions beyond SATURATED: means ...
    saturation_deviations: float = 0.0  # ... plus this many standard deviations
    max_grad_norm: float = 1.0
    max_cycles: int | None = None  # of training episodes; None: the task's own
    attention_start: float = 0.3  # fraction of training without the attention-entropy term ...
    attention_ramp: float = 0.2  # ... whose weight then grows from 0 over this fraction
    shaping: Shaping = field(default_factory=Shaping)
    caution_growth: float = 1.0  # agent and proximity penalties at the end, relative to the start
    variant: str = ""  # replaces the family in the names of runs

    def __post_init__(self) -> None:
        if not 1 <= self.batch_size <= self.n_envs * self.n_steps:
            raise InputError(
                f"batch_size must be from 1 to the {self.n_envs * self.n_steps} frames of an iteration, "
                f"got {self.batch_size}: choose a number in that range."
            )
        if self.attention_start + self.attention_ramp > 1.0:
            raise InputError(
                f"attention-start {self.attention_start:g} is too late: the weight of the term takes "
                f"{self.attention_ramp:g} of training to grow; start at "
                f"{1.0 - self.attention_ramp:g} or before."
            )

    @property
    def architecture(self) -> dict[str, Any]:
        """The fields of xmarl_bench.Architecture without obs_dim."""
        return architecture(self.task, self.family)

    def learning_rate_at(self, remaining: float) -> float:
        """SB3's schedule: `remaining` falls from 1 to 0, or below if the last iteration overshoots."""
        remaining = max(0.0, remaining)
        return self.learning_rate * (self.final_learning_rate + (1.0 - self.final_learning_rate) * remaining)

    def fine_tuning(self) -> Recipe:
        """The recipe of a run that starts from a finished one.

        A third of the frames and learning rate, lambda from the start with a longer ramp, and the penalties
        with which the finished run ended.
        """
        iteration = self.n_envs * self.n_steps
        return replace(
            self,
            frames=max(iteration, self.frames // 3 // iteration * iteration),
            learning_rate=self.learning_rate / 3,
            attention_start=0.0,
            attention_ramp=0.5,
            shaping=self.shaping.with_caution(self.caution_growth),
            caution_growth=1.0,
        )

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Recipe:
        """The recipe in a card. Raises InputError if it has unknown fields, as of an older trainer."""
        unknown = sorted(record.keys() - {each.name for each in fields(cls)})
        if unknown:
            raise InputError(
                f"the recipe has unknown fields ({', '.join(unknown)}): another version of xmarl-train "
                f"wrote it; use that version."
            )
        nested = {"shaping": Shaping(**record["shaping"]), "critic": tuple(record["critic"])}
        return cls(**{**record, **nested})


# Tuned on this physics; paper_schedule.py has the paper's own. Penalties are small from the first frame and
# grow over training: the team stops moving under large ones, and ignores ones that start late.
RECIPES: dict[str, Recipe] = {
    "blind_navigation_v0": Recipe(
        task="blind_navigation_v0",
        frames=4_800_000,
        n_envs=240,
        n_steps=150,
        n_epochs=2,
        batch_size=900,
        learning_rate=1e-3,
        shaping=Shaping(
            individual_progress=True,
            arrival_bonus=1.0,
            agent_penalty=0.3,
            proximity_penalty=0.05,
            proximity_range=0.2,
        ),
        caution_growth=3.0,
    ),
    "blind_passage_v0": Recipe(
        task="blind_passage_v0",
        frames=9_600_000,
        n_envs=200,
        n_steps=150,
        n_epochs=4,
        batch_size=1500,
        learning_rate=1e-3,
        shaping=Shaping(scale=0.05, agent_penalty=6.0, wall_penalty=1.5, through_gap=True),
        caution_growth=2.0,
    ),
    "blind_discovery_v0": Recipe(
        task="blind_discovery_v0",
        frames=5_120_000,
        n_envs=256,
        n_steps=200,
        n_epochs=2,
        batch_size=2560,
        learning_rate=7e-4,
        gamma=0.995,
        ent_coef=2e-3,
        shaping=Shaping(landmark_progress=1.0, search_reward=3.0),
    ),
}


# For teams that wait for one another for ever, or park a little too far from their goals.
PASSAGE_ON_TIME = replace(RECIPES["blind_passage_v0"].shaping, arrival_bonus=20.0, time_penalty=0.2)
WITHOUT_WAITING = {"frames": 7_200_000, "shaping": PASSAGE_ON_TIME, "saturation_penalty": 0.1}
NAVIGATION_ON_TIME = replace(RECIPES["blind_navigation_v0"].shaping, time_penalty=0.02)


# What a family changes for teams of at least this size, in ascending order.
#
# `residual`: navigation takes longer to learn. In passage agents of larger teams wait unless time costs
# something; four then bear a penalty for touching that grows threefold, five only a steady one. Raw actions
# can grow without end.
#
# `paper`: in navigation agents wait for one another if time costs nothing, and larger teams learn little with
# minibatches of 900. Passage's penalties keep the team from the gap (0.02 success after 9.6 M frames without
# a bonus), and its noise can grow without end. Discovery needs many more gradient steps, of smaller
# minibatches, and less of a bonus for noise.
CHANGES: dict[Family, dict[str, dict[int, dict[str, Any]]]] = {
    "residual": {
        "blind_navigation_v0": {4: {"frames": 7_200_000}, 5: {"frames": 9_600_000}},
        "blind_passage_v0": {
            4: {**WITHOUT_WAITING, "caution_growth": 3.0},
            5: {"caution_growth": 1.0},
        },
        "blind_discovery_v0": {},
    },
    "paper": {
        "blind_navigation_v0": {
            4: {"n_epochs": 4, "batch_size": 300, "shaping": NAVIGATION_ON_TIME},
            5: {"frames": 7_200_000},
        },
        "blind_passage_v0": {
            1: {
                **WITHOUT_WAITING,
                "shaping": replace(PASSAGE_ON_TIME, agent_penalty=3.0, wall_penalty=0.5),
                "caution_growth": 1.0,
                "saturation_deviations": 1.0,
            }
        },
        "blind_discovery_v0": {
            1: {"frames": 7_680_000, "n_epochs": 4, "batch_size": 800, "ent_coef": 1e-4},
        },
    },
}


def recipe_for(task: str, n_agents: int = 3, *, family: Family = "residual", **changes: Any) -> Recipe:
    """The recipe of a task, team size and family, with fields changed.

    Raises InputError for an unknown task or family.
    """
    if task not in RECIPES:
        raise InputError(f"no training recipe for task {task!r}: choose one of {', '.join(RECIPES)}.")
    architecture(task, family)  # raises for an unknown family
    reached = up_to(n_agents, CHANGES[family][task])
    usual = {name: value for change in reached for name, value in change.items()}
    return replace(RECIPES[task], **{**usual, "family": family, **changes})


def up_to(n_agents: int, by_size: dict[int, T]) -> list[T]:
    """The values of the sizes that the team reaches, in the table's order."""
    return [value for size, value in by_size.items() if size <= n_agents]
