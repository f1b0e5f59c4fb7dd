"""The card of a dataset: what its arrays mean, where they come from, and how to read them."""

from __future__ import annotations

from typing import Final

from pydantic import BaseModel, ConfigDict

from xmarl_bench.records.markdown import markdown_table

# Array -> its meaning. S timesteps of E episodes, N agents, D observation entries, A action entries.
MEANINGS: Final[dict[str, str]] = {
    "observation": "(S, N, D) what the policy reads; of a policy with memory, its memory comes last",
    "action": "(S, N, A) F(1), the deterministic action that is explained, in [-1, 1]; of a policy with "
    "numbered actions, their probabilities",
    "attention": "(S, N, N) coefficients; [s, i, j] of the message from j to i",
    "edge": "(S, N, N) 1 if the policy's graph has the edge; without this array it is complete",
    "change": "(2^N, S, N) d_i if agent i hears the agents in the bits of r alone, under `zero`",
    "message_change_zero": "(2^(N-1), S, N) the same over the other agents, the own message kept",
    "message_change_mean": "the same under the absence model `mean`",
    "message_change_resample": "the same under the absence model `resample`",
    "message_change_renormalised": "the same under the absence model `renormalised`",
    "reference": "(Q, N, D) observations of other episodes: to fit explainers on, and as stand-ins",
    "episode": "(S,) number of the episode, from 0",
    "timestep": "(S,) step within its episode, from 0",
    "seed": "(E,) of the environment",
    "relevant": "(S, N, N) 1 if the message from j to i is relevant: the planted truth",
    "counted": "(S, N) 1 for receivers that the truth judges",
}


class Card(BaseModel):
    """Describes a dataset of one policy. Kept in the file itself, so that it cannot be lost."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: str
    task: str
    n_agents: int
    episodes: int
    seed: int  # of a `score` run, which plays the same episodes
    weights_sha256: str | None = None  # of the policy; None for planted truth
    harness_version: str

    def page(self, arrays: dict[str, tuple[str, tuple[int, ...]]]) -> str:
        """The card as Markdown. arrays: name -> (dtype, shape)."""
        about = (
            f"# {self.name}\n\n{self.episodes} episodes of {self.task} with {self.n_agents} agents, from "
            f"xmarl-bench {self.harness_version}, seed {self.seed}.\n\n"
        )
        rows = [
            (f"`{name}`", dtype, " x ".join(map(str, shape)), MEANINGS[name])
            for name, (dtype, shape) in arrays.items()
        ]
        return about + markdown_table(("array", "dtype", "shape", "meaning"), rows)
