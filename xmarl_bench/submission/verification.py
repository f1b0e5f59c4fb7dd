"""A tier's verdict on entries, and the block that signs one off.

The verdict never touches a measured value: the block is no part of the entry's id.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import StrEnum
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from xmarl_bench.entry.provenance import now
from xmarl_bench.entry.schema import Entry, ExplainerRecord, Verification
from xmarl_bench.errors import InputError
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.origin.installed import package_version
from xmarl_bench.origin.references import Origin
from xmarl_bench.plugins.registry import EXPLAINERS, find_explainer, find_policy
from xmarl_bench.policy import Policy, PolicyCard, load_policy
from xmarl_bench.records.strict_json import shown
from xmarl_bench.scoring.score import explainer_record
from xmarl_bench.submission.checking import MAX_FINDINGS, Checked
from xmarl_bench.submission.consistency import CLOSE
from xmarl_bench.submission.limits import Limits
from xmarl_bench.submission.recompute import Difference
from xmarl_bench.submission.rerun import record_findings, rerun
from xmarl_bench.submission.sandbox import Sandbox
from xmarl_bench.submission.tolerance import AGGREGATES, Platform, agrees, disagreeing, is_same_platform

OURS = "xmarl-bench"  # the distribution whose explainers are no strangers


class Tier(StrEnum):
    recompute = "recompute"  # aggregates from rows; nothing is run
    spot = "spot"  # some episodes again
    full = "full"  # everything again


STATUS = {Tier.recompute: "recomputed", Tier.spot: "spot-rerun", Tier.full: "re-executed"}


@dataclass(frozen=True)
class Options:
    """How to run an entry again."""

    tier: Tier
    episodes: int = 10  # of each cell, for spot
    seed: int | None = None  # draws them; None draws others each time, so that nobody knows which
    explainer: str | None = None  # instead of the name in the entry: module:Name or file.py:Name
    trust_code: bool = False
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise InputError(f"episodes must be at least 1, got {self.episodes}: play some again.")


@dataclass(frozen=True)
class Verdict:
    """What a tier found on one entry."""

    entry: Entry
    tier: Tier
    bitwise: bool
    episodes: int  # played again
    max_abs_diff: float | None  # of all numbers compared; None where one of the two is null
    findings: tuple[str, ...]

    def record(self, path: str, file: str) -> dict[str, object]:
        """For programs."""
        return {
            "path": path,
            "file": file,
            "entry_id": self.entry.entry_id,
            "tier": self.tier.value,
            "passed": not self.findings,
            "bitwise": self.bitwise,
            "episodes": self.episodes,
            "max_abs_diff": self.max_abs_diff,
            "findings": list(self.findings),
        }

    def block(self, by: str) -> Verification:
        """Signed off. Raises InputError for an entry that did not pass, or for no name."""
        if self.findings:
            raise InputError("an entry that did not pass is not signed off: see what was found.")
        if not by.strip():
            raise InputError("a verdict is signed off by somebody: give a name.")
        here = Platform.here()
        return Verification.model_validate(
            {
                "status": STATUS[self.tier],
                "by": by,
                "when": now(),
                "harness_version": package_version("xmarl-bench") or "unknown",
                "packages": here.packages,
                "machine": f"{here.machine}, {here.cpu}, {here.cpu_capability}",
                "episodes": self.episodes,
                "bitwise": self.bitwise,
                "max_abs_diff": self.max_abs_diff,
            }
        )


def verify(checked: Checked, file: str, options: Options) -> Verdict:
    """The verdict on an entry of what was checked and found valid.

    Raises InputError where the entry cannot be run again: its explainer is a stranger's and not trusted, or
    not installed, or fails.
    """
    entry = checked.entries[file]
    bitwise = is_same_platform(entry)
    if options.tier is Tier.recompute:
        differences = checked.recomputed[file]
        tolerance = None if bitwise else CLOSE
        apart = [each for each in differences if not agrees(each, tolerance)]
        return Verdict(entry, options.tier, bitwise, 0, _largest(differences), _said(apart, "rows give"))
    rng = np.random.default_rng(options.seed)
    with ExitStack() as stack:
        policy, card = _policy(checked, entry)
        explainer, findings = _explainer(entry, options, stack)
        if card.weights_sha256 != entry.policy.weights_sha256:
            findings.append(f"policy {entry.policy.name!r} is installed with other weights than the entry's.")
        if findings:
            return Verdict(entry, options.tier, bitwise, 0, None, tuple(findings))
        episodes = None if options.tier is Tier.full else options.episodes
        again = rerun(entry, policy, card, explainer, episodes=episodes, rng=rng)
    apart = disagreeing(again.episodes, bitwise=bitwise)
    tolerance = None if bitwise else AGGREGATES
    apart += [each for each in again.aggregates if not agrees(each, tolerance)]
    said = (*again.findings, *_said(apart, "rerun gives"))
    return Verdict(entry, options.tier, bitwise, len(again.episodes), _largest(again.differences), said)


def verify_one(unit: tuple[Checked, str], options: Options) -> Verdict:
    """As `verify`, of a pair as workers are handed it."""
    return verify(*unit, options)


def _said(apart: list[Difference], source: str) -> tuple[str, ...]:
    said = [f"{each.where} is {each.entry}, the {source} {each.found}." for each in apart[:MAX_FINDINGS]]
    if len(apart) > MAX_FINDINGS:
        said.append(f"and {len(apart) - MAX_FINDINGS} numbers more differ.")
    return tuple(said)


def _largest(differences: list[Difference]) -> float | None:
    largest = max((each.size for each in differences), default=0.0)
    return largest if np.isfinite(largest) else None


def _policy(checked: Checked, entry: Entry) -> tuple[Policy, PolicyCard]:
    """That of the bundle, or the installed one of that name."""
    name = entry.policy.name
    return checked.load_policy(name) if name in checked.policies else load_policy(find_policy(name))


def _explainer(entry: Entry, options: Options, stack: ExitStack) -> tuple[Explainer, list[str]]:
    """The explainer to run, in a sandbox unless it is ours, and what it says otherwise than the entry."""
    name = entry.explainer.name if options.explainer is None else options.explainer
    if options.explainer is None and _is_ours(name):
        ours = find_explainer(name)
        return ours, list(record_findings(entry.explainer, explainer_record(ours, 0)))
    if not options.trust_code:
        raise InputError(
            f"explainer {shown(name)} is code of others: read it, then add --trust-code to run it walled in."
        )
    sandbox = stack.enter_context(Sandbox(name, options.limits))
    declared = ExplainerRecord.model_validate(sandbox.start(), strict=False)
    explainer = Explainer(
        name=declared.name,
        explain=sandbox.explains(),
        stochastic=declared.stochastic,
        binary=declared.binary,
        hyperparameters=declared.hyperparameters,
        fit=sandbox.fit if declared.needs_fit else None,
        origin=Origin(declared.distribution, declared.version, declared.entry_point),
    )
    return explainer, list(record_findings(entry.explainer, declared))


def _is_ours(name: str) -> bool:
    """Found without loading anything: strangers' packages register explainers too."""
    if name in CONTROLS:
        return True
    registered = entry_points(group=EXPLAINERS, name=name)
    return bool(registered) and all(each.dist is not None and each.dist.name == OURS for each in registered)


def lines(path: Path, file: str, verdict: Verdict) -> Iterator[str]:
    """For people: one line per finding, or one that says how well it did."""
    for finding in verdict.findings:
        yield f"{path}: {file}: {finding}"
    if not verdict.findings:
        how = "bit for bit" if verdict.bitwise else "within the tolerance of another platform"
        again = f", {verdict.episodes} episodes again" if verdict.tier is not Tier.recompute else ""
        yield (
            f"{path}: {file}: {STATUS[verdict.tier]}{again}, {how}, "
            f"largest difference {verdict.max_abs_diff}."
        )
