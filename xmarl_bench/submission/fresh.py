"""The tier that scores an entry on episodes that were unknown when it was submitted.

Their seeds derive from a value that is fixed after the submission, never from the submission
(`xmarl_bench.reproducible.fresh_seeds`). An explainer that was tuned to the public episodes does worse here.
Behaviour is not rolled out again.
"""

from __future__ import annotations

from dataclasses import replace

from xmarl_bench.entry.fresh import differences
from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.entry.provenance import now
from xmarl_bench.entry.schema import Entry, FreshSeeds
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.reproducible import fresh_seeds
from xmarl_bench.scoring.score import entries_of, score_requests
from xmarl_bench.submission.rerun import requests_of


def score_fresh(
    entry: Entry, policy: Policy, card: PolicyCard, explainer: Explainer, value: str
) -> FreshSeeds:
    """Score as many fresh episodes of each cell as the entry has public ones, at as many timesteps.

    The result is not signed: `by` is empty. Raises InputError if the value is not a valid source of seeds, or
    if the explainer fails.
    """
    episodes = entry.protocol.episodes
    seeds = tuple(fresh_seeds(PROTOCOL, value, episodes))
    requests = [
        replace(each, sampling=replace(each.sampling, given=seeds), behaviour_episodes=0)
        for each in requests_of(entry, policy, card, explainer)
    ]
    scored = zip(entry.results, entries_of(score_requests(requests)), strict=True)
    cells = tuple(differences(cell, again.results[0]) for cell, again in scored)
    return FreshSeeds(value=value, by="", when=now(), episodes=episodes, cells=cells)
