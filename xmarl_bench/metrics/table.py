"""The table of metrics, one row each. Everything else that lists metrics derives from it:

the entry's models, the protocol's definitions, comparisons, the board's columns, the tables of the commands,
the reasons why a metric was not measured, and the tables of docs/metrics.md. To add a metric, write its
function, its row here, and the line that computes it (for a mask: in `xmarl_bench/scoring/states.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from xmarl_bench.metrics.absence import Absence


class Group(StrEnum):
    """What a metric is measured on."""

    EXPLANATION = "of an explanation"  # a mask, on the states of an episode
    BEHAVIOUR = "of behaviour"  # the team, rolled out on the explanation and on its complement
    BEHAVIOUR_UNDER = "of behaviour under the other absence models"
    SANITY = "of an explainer's sanity"
    POLICY = "of the policy"
    GAIN = "of the gain from messages"
    TASK = "of the task"


OF_EXPLAINERS: Final = (Group.EXPLANATION, Group.BEHAVIOUR, Group.BEHAVIOUR_UNDER, Group.SANITY)
OF_POLICIES: Final = (Group.POLICY, Group.GAIN, Group.TASK)


class Direction(StrEnum):
    HIGHER = "higher"  # is better
    LOWER = "lower"
    NONE = "none"  # neither is better

    @property
    def arrow(self) -> str:
        return {"higher": "\u2191", "lower": "\u2193", "none": ""}[self]


class Need(StrEnum):
    """What a metric needs to be measured; `xmarl_bench.scoring.not_measured` states what is missing."""

    TWO_AGENTS = "2 agents"
    THREE_AGENTS = "3 agents"
    ORACLE = "an oracle"
    COEFFICIENTS = "known coefficients"
    DISTRIBUTION = "a distribution of actions"
    SEEDS = "a stochastic explainer"
    PLAYED = "behaviour episodes"
    WALLS = "walls"
    REWARDS = "finite rewards"
    SUCCESS = "a task that tells success"
    COLLISIONS = "a task that tells collisions"
    ATTENTION = "attention"
    SHARES = "coefficients that sum to 1"


@dataclass(frozen=True)
class Range:
    """The values that a metric can have; None: unbounded."""

    low: float | None = None
    high: float | None = None
    least: float | None = None  # the smallest value accepted, if there is no `low`

    @property
    def text(self) -> str:
        if self.low is not None and self.high is not None:
            return f"[{self.low:g}, {self.high:g}]"
        if self.low is not None:
            return f"at least {self.low:g}"
        return "any" if self.high is None else f"at most {self.high:g}"


SHARE, CHANGE, DELTA, CORRELATION = Range(0, 1), Range(0, 2), Range(-2, 2), Range(-1, 1)
NOT_NEGATIVE, ANY = Range(0), Range()
# 1 is the best ranking; only the smallest denominator, 1e-3 action units, bounds the worst.
BUDGETED = Range(high=1, least=-4000)


@dataclass(frozen=True)
class Metric:
    name: str  # key in entries
    title: str  # name in prose
    meaning: str  # one line
    definition: str | None  # part of the protocol: scores depend on every word. None: see FAMILIES
    group: Group
    range: Range
    direction: Direction = Direction.NONE
    unit: str = ""
    needs: tuple[Need, ...] = ()  # the first that is missing is the reason given
    heading: str = ""  # of a column; "": the title
    column: int | None = None  # order of the board's columns, smaller first; None: not shown there
    short: str | None = None  # heading on a terminal; None: not shown there
    digits: int = 3  # shown after the decimal point
    of_categoricals: str | None = None  # the definition for discrete actions, if it differs
    in_paper: bool = False  # one of the paper's four metrics, which every ranking shows
    optional: bool = False  # entries from before it was measured lack it, and keep their ids

    @property
    def nullable(self) -> bool:
        """Whether an entry may lack the metric, with a reason."""
        return bool(self.needs) or self.group is Group.SANITY

    @property
    def column_heading(self) -> str:
        return f"{self.heading or self.title} {self.direction.arrow}".rstrip()


HIGHER, LOWER = Direction.HIGHER, Direction.LOWER
ORDER: Final = "message_fidelity"  # the leaderboard's order
# Communication-only budgeted fidelity under each absence model, zero first: `ORDER` is their mean.
UNDER_ABSENCES: Final = tuple(f"{absence.prefix}_budgeted_fidelity" for absence in Absence)
OTHER_ABSENCES: Final = tuple(absence for absence in Absence if absence is not Absence.ZERO)
SUCCESS: Final = "success_rate"
GAINS: Final = {"success_gain": "success_rate", "reward_gain": "reward"}  # gain -> task metric

FAMILIES: Final = {
    "comm_*": "the same with every agent's own edge kept in subgraph and complement alike, so that messages "
    "between agents are ranked alone, k = 1 .. N - 2",
}


def _communication(base: Metric, column: int | None = None) -> Metric:
    return replace(
        base,
        name=f"comm_{base.name}",
        title=f"communication-only {base.title}",
        heading=f"comm. {base.heading or base.title}",
        meaning=f"{base.title} with every agent's own edge kept",
        definition=None,
        of_categoricals=None,
        needs=tuple(Need.THREE_AGENTS if each is Need.TWO_AGENTS else each for each in base.needs),
        column=column,
        short=None,
        in_paper=False,
    )


def _under(absence: str, meaning: str) -> Metric:
    """Budgeted fidelity under an absence model other than zero."""
    return Metric(
        f"{absence}_budgeted_fidelity", f"budgeted fidelity, {absence}", meaning,
        f"comm_budgeted_fidelity under the absence model {absence}", Group.EXPLANATION, BUDGETED, HIGHER,
        needs=(Need.THREE_AGENTS, Need.ORACLE, Need.COEFFICIENTS), column=2,
    )  # fmt: skip


def _acted_under(base: Metric, column: int | None = None) -> tuple[Metric, ...]:
    """A metric of behaviour, `base` under zero, under each of the other absence models."""
    return tuple(
        replace(
            base,
            name=f"{absence}_{base.name}",
            title=f"{base.title}, {absence}",
            meaning=f"{base.title} under the absence model {absence}",
            definition=f"{base.name} under the absence model {absence} at every step (resample: one draw for "
            "each team and step), of the first 10 episodes",
            group=Group.BEHAVIOUR_UNDER,
            needs=(*base.needs, Need.COEFFICIENTS),
            column=column,
            short=None,
            optional=True,
        )
        for absence in OTHER_ABSENCES
    )


_FID_PLUS = Metric(
    "fid_plus", "Fid+", "change of the action without the explanation", "mean over agents of d_i(1 - m)",
    Group.EXPLANATION, CHANGE, HIGHER, "action", column=3, short="Fid+", in_paper=True,
)  # fmt: skip
_FID_MINUS = Metric(
    "fid_minus", "Fid-", "change of the action with the explanation alone",
    "mean over agents of d_i(m), d_i(m) = mean over action entries of |F_i(1) - F_i(m)|",
    Group.EXPLANATION, CHANGE, LOWER, "action", heading="Fid\u2212", column=3, short="Fid-", in_paper=True,
    of_categoricals="mean over agents of d_i(m), d_i(m) = total variation distance of F_i(1) and F_i(m)",
)  # fmt: skip
_FID_DELTA = Metric(
    "fid_delta", "FidDelta", "Fid+ less Fid-; can be gamed", "fid_plus - fid_minus",
    Group.EXPLANATION, DELTA, HIGHER, "action", column=3, short="FidDelta", in_paper=True,
)  # fmt: skip
_GEF = Metric(
    "gef", "GEF", "divergence of the action distribution, mapped to [0, 1]",
    "mean over agents of 1 - exp(-KL(F_i(1) || F_i(m))), diagonal Normals under the tanh, summed over "
    "action entries",
    Group.EXPLANATION, SHARE, LOWER, needs=(Need.DISTRIBUTION,), column=3, short="GEF", in_paper=True,
    of_categoricals="mean over agents of 1 - exp(-KL(F_i(1) || F_i(m))), of the categoricals",
)  # fmt: skip
_TOPK_FID_DELTA = Metric(
    "topk_fid_delta", "FidDelta@k", "FidDelta of the k highest edges of each row, mean over k",
    "FidDelta@k, mean over k = 1 .. N - 1: fid_delta of the binary mask that keeps the k highest edges of "
    "each row, averaged over the choices among equal ones",
    Group.EXPLANATION, DELTA, HIGHER, "action", (Need.TWO_AGENTS,),
)  # fmt: skip
_BUDGETED_FIDELITY = Metric(
    "budgeted_fidelity", "budgeted fidelity", "FidDelta@k, scaled: 0 is a random ranking, 1 the best",
    "(FidDelta@k - random@k) / (oracle@k - random@k), mean over k = 1 .. N - 1; random@k is the mean over "
    "all k-subsets of a row and oracle@k the maximum; each averaged over agents and timesteps of the "
    "episode before dividing; a k whose denominator is under 0.001 is left out, null where none is left",
    Group.EXPLANATION, BUDGETED, HIGHER, needs=(Need.TWO_AGENTS, Need.ORACLE), column=3,
)  # fmt: skip
_SUCCESS_ON_EXPLANATION = Metric(
    "success_on_explanation", "success on explanation",
    "success of a team that hears the explanation only",
    "success_rate where the team communicates only along the k = floor((N - 1) / 2) highest messages of "
    "each row of the explanation of its own states; own edges are kept",
    Group.BEHAVIOUR, SHARE, HIGHER, needs=(Need.PLAYED, Need.SUCCESS), column=3, short="success on mask",
)  # fmt: skip
_SUCCESS_ON_COMPLEMENT = Metric(
    "success_on_complement", "success on complement",
    "success of a team that hears the complement only",
    "the same, communicating only along the other messages",
    Group.BEHAVIOUR, SHARE, LOWER, needs=(Need.PLAYED, Need.SUCCESS), column=3, short="on complement",
)  # fmt: skip
_BEHAVIOURAL_FIDELITY = Metric(
    "behavioural_fidelity", "behavioural fidelity", "difference of the two successes",
    "success_on_explanation - success_on_complement",
    Group.BEHAVIOUR, CORRELATION, HIGHER, needs=(Need.PLAYED, Need.SUCCESS),
)  # fmt: skip

METRICS: tuple[Metric, ...] = (
    _FID_PLUS,
    _FID_MINUS,
    _FID_DELTA,
    _GEF,
    Metric(
        "median_kl", "median KL", "the divergence itself, because GEF saturates",
        "median of that KL over the agents and timesteps of an episode",
        Group.EXPLANATION, NOT_NEGATIVE, LOWER, "nats", (Need.DISTRIBUTION,), column=3,
    ),
    Metric(
        "mask_mass", "mask mass", "how much the mask keeps",
        "mean of the mask over all edges, the agents' own among them",
        Group.EXPLANATION, SHARE, column=3, short="mass",
    ),
    _TOPK_FID_DELTA,
    _BUDGETED_FIDELITY,
    _communication(_FID_PLUS),
    _communication(_FID_MINUS),
    _communication(_FID_DELTA, 3),
    _communication(_GEF, 3),
    _communication(_TOPK_FID_DELTA),
    _communication(_BUDGETED_FIDELITY, 2),
    _under("mean", "communication-only, mean messages replace dropped ones"),
    _under("resample", "communication-only, messages of other states replace dropped ones"),
    _under("renormalised", "communication-only, dropped edges leave the softmax"),
    Metric(
        "message_fidelity", "message fidelity",
        "communication-only budgeted fidelity, mean over absence models",
        "mean of comm_budgeted_fidelity, which is under the absence model zero, and of its like under the "
        "others, of those that can be measured",
        Group.EXPLANATION, BUDGETED, HIGHER, needs=(Need.THREE_AGENTS, Need.ORACLE), column=1,
        short="message fidelity",
    ),
    Metric(
        "smallest_message_fidelity", "smallest message fidelity", "the smallest over absence models",
        "the smallest of the numbers that message_fidelity is the mean of",
        Group.EXPLANATION, BUDGETED, HIGHER, needs=(Need.THREE_AGENTS, Need.ORACLE), column=2,
        short="smallest",
    ),
    _SUCCESS_ON_EXPLANATION,
    _SUCCESS_ON_COMPLEMENT,
    Metric(
        "reward_on_explanation", "reward on explanation", "reward of a team that hears the explanation only",
        "reward of the team on the explanation",
        Group.BEHAVIOUR, ANY, HIGHER, "reward", (Need.PLAYED, Need.REWARDS),
    ),
    Metric(
        "reward_on_complement", "reward on complement", "reward of a team that hears the complement only",
        "reward of the team on the complement",
        Group.BEHAVIOUR, ANY, LOWER, "reward", (Need.PLAYED, Need.REWARDS),
    ),
    Metric(
        "no_agent_collision_on_explanation", "collision-free on explanation",
        "episodes without collision of a team that hears the explanation only",
        "no_agent_collision of the team on the explanation",
        Group.BEHAVIOUR, SHARE, HIGHER, needs=(Need.PLAYED, Need.COLLISIONS), column=3,
    ),
    Metric(
        "no_agent_collision_on_complement", "collision-free on complement",
        "episodes without collision of a team that hears the complement only",
        "no_agent_collision of the team on the complement",
        Group.BEHAVIOUR, SHARE, LOWER, needs=(Need.PLAYED, Need.COLLISIONS), column=3,
    ),
    _BEHAVIOURAL_FIDELITY,
    *_acted_under(_SUCCESS_ON_EXPLANATION),
    *_acted_under(_SUCCESS_ON_COMPLEMENT),
    *_acted_under(_BEHAVIOURAL_FIDELITY, 3),
    Metric(
        "seed_stability", "seed stability", "rank correlation of the masks of several seeds",
        "rank correlation of the masks of 3 seeds, mean over pairs; null where the explainer is not "
        "stochastic",
        Group.SANITY, CORRELATION, HIGHER, needs=(Need.SEEDS,), column=3,
    ),
    Metric(
        "weight_randomisation", "shuffled weights",
        "rank correlation with the mask of a policy whose weights were shuffled; near 0 is good",
        "rank correlation of the mask with that of the policy whose parameter tensors have their entries "
        "shuffled",
        Group.SANITY, CORRELATION, column=3,
    ),
    Metric(
        "communication_dependence", "communication dependence", "change of the action without any messages",
        "mean over agents of d_i(identity): what removing all messages between agents changes",
        Group.POLICY, CHANGE, unit="action", column=3, short="communication dependence",
    ),
    Metric(
        "attention_entropy", "attention entropy", "how evenly agents attend; log N is uniform",
        "mean over agents of the entropy of their attention, in nats",
        Group.POLICY, NOT_NEGATIVE, unit="nats", needs=(Need.ATTENTION, Need.SHARES), column=3,
        short="attention entropy", digits=2,
    ),
    Metric(
        "attention_distance", "D(alpha)", "how far attention is from its complement",
        "D(alpha) = sum over edges of |2 alpha - 1|",
        Group.POLICY, NOT_NEGATIVE, needs=(Need.ATTENTION, Need.SHARES), column=3,
    ),
    Metric(
        "success_gain", "success gained by messages", "success with messages less success without",
        "success_rate less that of the same episode without messages between agents, F(identity)",
        Group.GAIN, CORRELATION, needs=(Need.SUCCESS,), column=3, short="success gained", digits=2,
    ),
    Metric(
        "reward_gain", "reward gained by messages", "reward with messages less reward without",
        "reward less that of the same episode without messages between agents",
        Group.GAIN, ANY, unit="reward", needs=(Need.REWARDS,), column=3, digits=2,
    ),
    Metric(
        "reward", "reward", "return of an agent", "mean over agents of the return",
        Group.TASK, ANY, HIGHER, "reward", (Need.REWARDS,), column=2, short="reward", digits=2,
    ),
    Metric(
        "success_rate", "success rate", "fraction of agents at the goal in the end",
        "fraction of agents at goal when the episode ends; discovery: 1 if found",
        Group.TASK, SHARE, HIGHER, needs=(Need.SUCCESS,), column=1, short="success", digits=2,
    ),
    Metric(
        "no_agent_collision", "no agent collision", "episodes in which no two agents touch",
        "1 if no two agents collided in the episode",
        Group.TASK, SHARE, HIGHER, needs=(Need.COLLISIONS,), column=1, short="no agent collision", digits=2,
    ),
    Metric(
        "no_object_collision", "no object collision", "episodes in which nobody touches a wall",
        "1 if nobody touched a wall; null where there are no walls",
        Group.TASK, SHARE, HIGHER, needs=(Need.WALLS,), column=1, short="no wall contact", digits=2,
    ),
    Metric(
        "makespan", "makespan", "length of the episode", "steps until done, max_cycles if never",
        Group.TASK, NOT_NEGATIVE, LOWER, "steps", column=1, short="makespan", digits=0,
    ),
)  # fmt: skip


# Compared between public and fresh seeds. The first of HEADLINES that is measured says who does worse there.
ON_FRESH: Final = (ORDER, *(each.name for each in METRICS if each.in_paper))
HEADLINES: Final = (ORDER, _FID_DELTA.name)
OPTIONAL: Final = tuple(each.name for each in METRICS if each.optional)


def metrics_of(*groups: Group) -> tuple[Metric, ...]:
    """The rows of these groups, in the table's order."""
    return tuple(each for each in METRICS if each.group in groups)


def names_of(*groups: Group) -> tuple[str, ...]:
    return tuple(each.name for each in metrics_of(*groups))


def columns_of(*groups: Group) -> tuple[Metric, ...]:
    """The metrics that the board shows, in its order."""
    shown = [(each.column, each) for each in metrics_of(*groups) if each.column is not None]
    return tuple(each for _, each in sorted(shown, key=lambda pair: pair[0]))


def by_name() -> dict[str, Metric]:
    return {each.name: each for each in METRICS}
