"""Verifies entries by a tier, and writes the verification block of those that pass.

Verification changes no measured value, and the block is not part of the entry's id.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from xmarl_bench.counted import counted
from xmarl_bench.entry.file import read_entry
from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.entry.provenance import provenance
from xmarl_bench.entry.schema import Entry, FreshSeeds, Verification
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.isolation.conversation import Isolation, end_strangers
from xmarl_bench.isolation.limits import Limits
from xmarl_bench.isolation.walls import SIGNED, Wall, strongest
from xmarl_bench.plugins.names import find_policy, is_shipped
from xmarl_bench.plugins.registry import ask_explainer, find_explainer
from xmarl_bench.policy import Policy, PolicyCard, load_policy
from xmarl_bench.records.strict_json import shown
from xmarl_bench.reproducible import fresh_seeds
from xmarl_bench.submission.checking import MAX_FINDINGS, Checked
from xmarl_bench.submission.fresh import score_fresh
from xmarl_bench.submission.recompute import Difference
from xmarl_bench.submission.rerun import Rerun, other_explainer, rerun
from xmarl_bench.submission.rounding import CLOSE
from xmarl_bench.submission.tolerance import AGGREGATES, agrees, disagreeing, is_same_platform


class Tier(StrEnum):
    recompute = "recompute"  # recomputes aggregates from rows; runs nothing
    spot = "spot"  # runs some episodes again
    full = "full"  # runs everything again
    fresh = "fresh"  # runs other episodes, unknown at submission


# Fresh seeds say nothing of the entry's own rows: their aggregates alone are derived again.
STATUS = {
    Tier.recompute: "recomputed",
    Tier.spot: "spot-rerun",
    Tier.full: "re-executed",
    Tier.fresh: "recomputed",
}


@dataclass(frozen=True)
class Options:
    """How to run an entry again."""

    tier: Tier
    episodes: int = 10  # of each cell, for spot
    seed: int | None = None  # for the choice of these episodes; None: unpredictable
    explainer: str | None = None  # replaces the name in the entry: module:Name or file.py:Name
    trust_code: bool = False
    limits: Limits = field(default_factory=Limits)
    wall: Wall | None = None  # around third-party code; None: the strongest that works here
    fresh_from: str | None = None  # fixed after the submission, for fresh

    def __post_init__(self) -> None:
        if (self.tier is Tier.fresh) != (self.fresh_from is not None):
            raise InputError(
                "tier fresh needs --fresh-from, and no other tier has an effect of it: give a value that was "
                "fixed after the submission, such as the hash of a later commit."
            )
        if self.fresh_from is not None:
            fresh_seeds(PROTOCOL, self.fresh_from, 1)
        if self.episodes < 1:
            raise InputError(f"episodes must be at least 1, got {self.episodes}: give a larger number.")


@dataclass(frozen=True)
class Verdict:
    """The result of a tier on one entry."""

    entry: Entry
    tier: Tier
    bitwise: bool
    episodes: int  # played again
    max_abs_diff: float | None  # of all numbers compared; None if only one of two numbers is null
    findings: tuple[str, ...]
    fresh: FreshSeeds | None = None  # of fresh alone; not yet signed
    wall: Wall | None = None  # what third-party code ran behind; None: none ran

    def record(self, path: str, file: str) -> dict[str, object]:
        """The verdict for JSON."""
        return {
            "path": path,
            "file": file,
            "entry_id": self.entry.entry_id,
            "tier": self.tier.value,
            "passed": not self.findings,
            "bitwise": self.bitwise,
            "episodes": self.episodes,
            "max_abs_diff": self.max_abs_diff,
            "wall": self.wall,
            "findings": list(self.findings),
            "fresh": None if self.fresh is None else self.fresh.model_dump(exclude={"by", "when"}),
        }

    def block(self, by: str, before: Verification | None = None) -> Verification:
        """The verification block, signed by `by`.

        Raises InputError if the entry failed, if `by` is empty, and if third-party code ran behind no wall.
        before: the block to replace or add to, by default the entry's own.
        """
        if self.findings:
            raise InputError(f"the entry failed verification and cannot be signed: {self.findings[0]}")
        if not by.strip():
            raise InputError("the name that signs the entry is empty: give one with --by.")
        if self.wall not in (None, *SIGNED):
            raise InputError(
                f"third-party code ran behind no wall here and could have changed what was measured: install "
                f"bubblewrap, or verify where the kernel has Landlock, to sign {self.entry.file_name}."
            )
        before, here = before or self.entry.verification, provenance("", 1)
        fresh = self.fresh and self.fresh.model_copy(update={"by": by, "when": here.finished})
        if self.fresh is not None and before.status != "unverified":
            return before.model_copy(update={"fresh": fresh, "wall": self.wall or before.wall})
        return Verification.model_validate(
            {
                "status": STATUS[self.tier],
                "by": by,
                "when": here.finished,
                "harness_version": here.harness_version,
                "commit": here.commit,
                "dirty": here.dirty,
                "packages": here.packages,
                "machine": f"{here.machine}, {here.cpu}, {here.cpu_capability}",
                "episodes": self.episodes,
                "bitwise": self.bitwise,
                "max_abs_diff": self.max_abs_diff,
                "fresh": fresh or before.fresh,
                "wall": self.wall,
            }
        )


def signed(verdict: Verdict, by: str, folder: Path) -> Entry:
    """The entry with its block, which adds to the block of the same entry in the folder.

    Raises as `Verdict.block`.
    """
    there = _same_entry(verdict.entry, folder)
    block = verdict.block(by, None if there is None else there.verification)
    return verdict.entry.model_copy(update={"verification": block})


def verify(checked: Checked, file: str, options: Options) -> Verdict:
    """The verdict on a valid entry of `checked`.

    Raises InputError if the entry cannot be run again: its explainer is not trusted, not installed, or fails.
    """
    entry = checked.entries[file]
    bitwise = is_same_platform(entry)
    if options.tier in (Tier.recompute, Tier.fresh):
        differences = checked.recomputed[file]
        tolerance = None if bitwise else CLOSE
        apart = [each for each in differences if not agrees(each, tolerance)]
        found = _sentences(apart, "rows give")
        recomputed = Verdict(entry, options.tier, bitwise, 0, _largest(differences), found)
        if options.tier is Tier.recompute or found:
            return recomputed
    rng = np.random.default_rng(options.seed)
    policy, card = policy_of(checked, entry)
    try:
        explainer, wall = _explainer(entry, options)
        findings = other_explainer(entry, explainer) + other_weights(entry, card)
        if findings:
            return Verdict(entry, options.tier, bitwise, 0, None, tuple(findings), wall=wall)
        if options.fresh_from is not None:
            fresh = score_fresh(entry, policy, card, explainer, options.fresh_from)
            return replace(recomputed, fresh=fresh, wall=wall)
        episodes = None if options.tier is Tier.full else options.episodes
        again = rerun(entry, policy, card, explainer, episodes=episodes, rng=rng)
    finally:
        end_strangers()
    return replace(verdict_of(entry, options.tier, again), wall=wall)


def verdict_of(entry: Entry, tier: Tier, again: Rerun) -> Verdict:
    """The verdict on an entry that was run again."""
    bitwise = is_same_platform(entry)
    apart = disagreeing(again.episodes, bitwise=bitwise)
    tolerance = None if bitwise else AGGREGATES
    apart += [each for each in again.aggregates if not agrees(each, tolerance)]
    found = (*again.findings, *_sentences(apart, "rerun gives"))
    return Verdict(entry, tier, bitwise, len(again.episodes), _largest(again.differences), found)


def is_signed(entry: Entry, by: str, folder: Path, options: Options) -> bool:
    """Whether the folder holds the entry with a block of this tier that `by` signed."""
    there = _same_entry(entry, folder)
    if there is None:
        return False
    block, fresh = there.verification, there.verification.fresh
    if options.tier is Tier.fresh:
        return fresh is not None and (fresh.by, fresh.value) == (by, options.fresh_from)
    return (block.by, block.status) == (by, STATUS[options.tier])


def _same_entry(entry: Entry, folder: Path) -> Entry | None:
    """The entry as it is in the folder; None if that does not hold it."""
    path = folder / entry.file_name
    there = read_entry(path) if path.is_file() else None
    return None if there is None or there.entry_id != entry.entry_id else there


def _sentences(apart: list[Difference], source: str) -> tuple[str, ...]:
    found = [each.sentence(source) for each in apart[:MAX_FINDINGS]]
    if len(apart) > MAX_FINDINGS:
        found.append(f"and {counted(len(apart) - MAX_FINDINGS, 'more difference')}.")
    return tuple(found)


def _largest(differences: list[Difference]) -> float | None:
    largest = max((each.size for each in differences), default=0.0)
    return largest if np.isfinite(largest) else None


def policy_of(checked: Checked, entry: Entry) -> tuple[Policy, PolicyCard]:
    """The policy of the bundle, or else the installed one of that name."""
    name = entry.policy.name
    return checked.load_policy(name) if name in checked.policies else load_policy(find_policy(name))


def other_weights(entry: Entry, card: PolicyCard) -> list[str]:
    """A finding if the policy at hand is not the entry's."""
    if card.weights_sha256 == entry.policy.weights_sha256:
        return []
    return [f"the installed policy {entry.policy.name!r} has other weights than the entry's."]


def _explainer(entry: Entry, options: Options) -> tuple[Explainer, Wall | None]:
    """The explainer to run, and its wall; None if it is shipped."""
    name = entry.explainer.name if options.explainer is None else options.explainer
    if options.explainer is None and is_shipped(name):
        return find_explainer(name), None
    if not options.trust_code:
        raise InputError(
            f"explainer {shown(name)} is third-party code: read it, then add --trust-code to run it in a "
            f"sandbox."
        )
    wall = options.wall or strongest()
    return ask_explainer(name, Isolation(options.limits, wall)), wall
