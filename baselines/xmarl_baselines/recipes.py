"""How each shipped policy is trained: one recipe per task, every option stated once."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from xmarl_baselines.imitation import Imitation
from xmarl_baselines.shaping import Shaping
from xmarl_bench.errors import InputError


@dataclass(frozen=True)
class Recipe:
    """Hyperparameters of one task: imitation, MAPPO, or one after the other."""

    task: str
    architecture: dict[str, Any]  # of xmarl_bench.Architecture, without obs_dim
    critic: tuple[int, ...]
    frames: int  # team-steps of MAPPO; 0: imitation alone
    n_envs: int  # teams stepped together
    n_steps: int  # per team and iteration: an iteration is n_envs * n_steps frames
    n_epochs: int
    batch_size: int  # team-steps per gradient step; the last one of an epoch may be smaller
    learning_rate: float  # at the start; falls linearly to learning_rate * final_learning_rate
    final_learning_rate: float = 0.1  # fraction
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    normalize_advantage: bool = True
    ent_coef: float = 1e-4
    noise_penalty: float = 0.0  # see MAPPO
    max_grad_norm: float = 1.0
    max_cycles: int | None = None  # of training episodes; None: the task's own
    distance_attention: float = 0.0  # sharpness of attend_by_distance at the start; 0: torch's initialisation
    place_code: float = 0.0  # sharpness of attention under code_places at the start; 0: without it
    attention_ramp: float = 0.2  # fraction of training over which lambda grows from 0 ...
    attention_start: float = 0.3  # ... after this fraction without it
    imitation: Imitation | None = None  # warm start of the actor; None: from its initial weights
    critic_first: float = 0.0  # fraction of training in which only the critic learns
    shaping: Shaping = field(default_factory=Shaping)
    caution_growth: float = 1.0  # agent and proximity penalties at the end, relative to the start
    enough_success: float = 1.0  # model selection: success beyond this counts no more
    care: float = 0.0  # model selection: what the collision-free rate counts, relative to success
    variant: str = ""  # goes into the names of runs, where a task has more recipes than one

    def __post_init__(self) -> None:
        if not 1 <= self.batch_size <= self.n_envs * self.n_steps:
            raise InputError(
                f"batch_size must be from 1 to the {self.n_envs * self.n_steps} frames of an iteration, "
                f"got {self.batch_size}: choose a number in that range."
            )
        if self.frames == 0 and self.imitation is None:
            raise InputError("a recipe without imitation needs frames of MAPPO, got frames=0.")

    @property
    def played(self) -> int:
        """Team-steps that a run counts: those of MAPPO, or of the imitation where that is all."""
        return self.imitation.frames if self.imitation is not None and not self.frames else self.frames

    def learning_rate_at(self, remaining: float) -> float:
        """SB3's schedule: `remaining` falls from 1 to 0, and below where the last iteration is cut short."""
        remaining = max(0.0, remaining)
        return self.learning_rate * (self.final_learning_rate + (1.0 - self.final_learning_rate) * remaining)

    def fine_tuning(self) -> Recipe:
        """The recipe of a run that starts from a finished one: a third of its frames and learning rate,
        lambda from the start with a longer ramp, and the caution that the finished run ended with."""
        if not self.frames:
            raise InputError(f"the recipe of {self.task} is imitation alone: it has no MAPPO to go on with.")
        iteration = self.n_envs * self.n_steps
        return replace(
            self,
            imitation=None,
            critic_first=0.0,
            frames=self.frames // 3 // iteration * iteration,
            learning_rate=self.learning_rate / 3,
            attention_start=0.0,
            attention_ramp=0.5,
            shaping=self.shaping.with_caution(self.caution_growth),
            caution_growth=1.0,
        )

    def shortened(self, frames: int) -> Recipe:
        """The recipe with this many frames, and a warm start shortened (or prolonged) in proportion."""
        imitation = self.imitation
        if imitation is not None:
            rounds = max(1, round(imitation.rounds * frames / self.played))
            imitation = replace(imitation, rounds=rounds)
        return replace(self, frames=frames if self.frames else 0, imitation=imitation)

    def with_attention_start(self, share: float) -> Recipe:
        """The recipe whose attention-entropy term sets in after this share of its frames, or of its rounds
        of imitation where it is imitation alone. Raises InputError where its ramp would not end in time."""
        how = self._with_term
        if share + how.attention_ramp > 1.0:
            raise InputError(
                f"attention-start {share:g} is too late: the term takes {how.attention_ramp:g} of training "
                f"to grow to its weight; start at {1.0 - how.attention_ramp:g} or before."
            )
        changed = replace(how, attention_start=share)
        return changed if isinstance(changed, Recipe) else replace(self, imitation=changed)

    @property
    def starts_attention(self) -> float:
        """The share of training before the attention-entropy term."""
        return self._with_term.attention_start

    @property
    def _with_term(self) -> Recipe | Imitation:
        """What holds the term's schedule: imitation where there is nothing else."""
        return self if self.frames or self.imitation is None else self.imitation

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Recipe:
        """The recipe that a card holds; what it does not say (it is older) is the default."""
        nested = {
            "shaping": Shaping(**record["shaping"]),
            "imitation": None if record.get("imitation") is None else Imitation(**record["imitation"]),
            "critic": tuple(record["critic"]),
        }
        return cls(**{**record, **nested})

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


# Navigation with the paper's architecture (Kailas et al., ICML 2025, section "Tasks"). One mixture of six
# numbers does not tell an agent its own place from its partners': this is the best that was found for it.
PAPER_NAVIGATION = Recipe(
    task="blind_navigation_v0",
    architecture={
        "encoder": (), "encoder_activation": "tanh", "gat_width": 32, "gat_activation": "tanh",
        "decoder": (256, 256), "decoder_activation": "tanh",
    },
    critic=(128, 128),
    frames=3_006_000,
    n_envs=120,
    n_steps=150,
    n_epochs=4,
    batch_size=400,
    learning_rate=7e-4,
    distance_attention=2.5,
    ent_coef=-0.02,  # less noise: agents that wait for each other part by noise, and need not learn to
    shaping=Shaping(
        proximity_penalty=0.0375,
        proximity_range=0.15,
        agent_penalty=0.25,
        individual_progress=True,
        arrival_bonus=2.0,
        time_penalty=0.02,
    ),
    caution_growth=0.3,
    enough_success=0.96,
    care=0.5,
    variant="paper",
)  # fmt: skip

# Architecture of discovery: Kailas et al.; navigation's and passage's have encoders that theirs have not (in
# passage theirs made success easy, and 0.3 to 0.7 of the episodes without agents touching).
# Hyperparameters: what was seen to learn on this physics within minutes on one core; they are not the paper's
# (30 epochs, gamma 0.99999). All start from an imitation: MAPPO alone reached 0.04 of episodes without
# collision in passage (12 M frames) and 0.84 success in discovery (10 M frames), after 20 minutes each.
RECIPES: dict[str, Recipe] = {
    "blind_navigation_v0": replace(
        PAPER_NAVIGATION,
        architecture={
            "encoder": (128,), "encoder_activation": "tanh", "gat_width": 136, "gat_activation": "tanh",
            "decoder": (128, 128), "decoder_activation": "tanh",
        },
        frames=0,
        distance_attention=0.0,
        place_code=3.5,
        imitation=Imitation(rounds=150, teacher="wide_berth"),
        ent_coef=0.0,
        noise_penalty=0.05,
        enough_success=1.0,
        care=1.0,
        variant="",
    ),
    "blind_passage_v0": Recipe(
        task="blind_passage_v0",
        architecture={
            "encoder": (160,), "encoder_activation": "tanh", "gat_width": 176, "gat_activation": "tanh",
            "decoder": (128, 128), "decoder_activation": "tanh",
        },
        critic=(128, 128),
        frames=0,
        n_envs=128,
        n_steps=150,
        n_epochs=4,
        batch_size=1600,
        learning_rate=3e-4,
        max_cycles=200,
        place_code=1.5,
        attention_start=0.0,
        attention_ramp=0.0,
        imitation=Imitation(rounds=150, teacher="ladder", updates=25, attention_rate=0.1),
        critic_first=0.06,
        shaping=Shaping(scale=0.05, agent_penalty=10.0, wall_penalty=3.0, through_gap=True),
        care=1.0,
    ),
    "blind_discovery_v0": Recipe(
        task="blind_discovery_v0",
        architecture={
            "encoder": (64,), "encoder_activation": "relu", "gat_width": 64, "gat_activation": "relu",
            "decoder": (64, 64), "decoder_activation": "relu",
        },
        critic=(128, 128),
        frames=409_600,
        n_envs=256,
        n_steps=200,
        n_epochs=4,
        batch_size=2560,
        learning_rate=4e-4,
        gamma=0.995,
        attention_start=0.0,
        attention_ramp=0.0,
        imitation=Imitation(rounds=250),
        critic_first=0.1,
        shaping=Shaping(landmark_progress=1.0),
    ),
}  # fmt: skip

_PAPERS = Recipe(
    task="blind_navigation_v0",
    architecture=PAPER_NAVIGATION.architecture,
    critic=(32, 32),
    frames=150 * 18_000,
    n_envs=120,
    n_steps=150,
    n_epochs=30,
    batch_size=800,
    learning_rate=3e-4,
    final_learning_rate=1.0,  # no decay is mentioned
    gamma=0.99999,
    gae_lambda=0.9,
    normalize_advantage=False,
    attention_start=0.0,
    attention_ramp=0.0,  # nor a warm-up of lambda
    variant="schedule",
)

# The paper's own training tables (Kailas et al., ICML 2025, appendix) and architectures, from scratch, on the
# tasks' own rewards. How many teams share the frames of an iteration it does not say.
PAPER_SCHEDULE: dict[str, Recipe] = {
    "blind_navigation_v0": _PAPERS,
    "blind_passage_v0": replace(
        _PAPERS,
        task="blind_passage_v0",
        architecture={
            "encoder": (32, 32, 32, 32), "encoder_activation": "relu",
            "gat_width": 32, "gat_activation": "tanh",
            "decoder": (64, 64, 64, 64), "decoder_activation": "relu",
        },
        frames=100 * 60_000,
        n_envs=400,
        learning_rate=5e-5,
    ),
    "blind_discovery_v0": replace(
        _PAPERS,
        task="blind_discovery_v0",
        architecture=RECIPES["blind_discovery_v0"].architecture,
        critic=(128, 128),
        frames=1000 * 10_000,
        n_envs=100,
        n_steps=100,
        n_epochs=5,
        batch_size=10_000,
        learning_rate=7e-4,
        gamma=0.9999,
        gae_lambda=0.95,
        clip_range=0.05,
        normalize_advantage=True,
        max_grad_norm=10.0,
    ),
}  # fmt: skip


def recipe_for(task: str, **changes: Any) -> Recipe:
    """The recipe of a task, with fields changed. Raises InputError for an unknown task."""
    if task not in RECIPES:
        raise InputError(f"no training recipe for task {task!r}: choose one of {', '.join(RECIPES)}.")
    return replace(RECIPES[task], **changes)
