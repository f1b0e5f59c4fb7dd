"""Verifies entries by a tier, and writes the verification block of those that pass.

Verification changes no measured value, and the block is not part of the entry's id.
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

OURS = "xmarl-bench"  # the distribution whose explainers are trusted


class Tier(StrEnum):
    recompute = "recompute"  # recomputes aggregates from rows; runs nothing
    spot = "spot"  # runs some episodes again
    full = "full"  # runs everything again


STATUS = {Tier.recompute: "recomputed", Tier.spot: "spot-rerun", Tier.full: "re-executed"}


@dataclass(frozen=True)
class Options:
    """How to run an entry again."""

    tier: Tier
    episodes: int = 10  # of each cell, for spot
    seed: int | None = None  # for the choice of these episodes; None: unpredictable
    explainer: str | None = None  # replaces the name in the entry: module:Name or file.py:Name
    trust_code: bool = False
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
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
            "findings": list(self.findings),
        }

    def block(self, by: str) -> Verification:
        """The verification block, signed by `by`. Raises InputError if the entry failed or `by` is empty."""
        if self.findings:
            raise InputError(f"the entry failed verification and cannot be signed: {self.findings[0]}")
        if not by.strip():
            raise InputError("the name that signs the entry is empty: give one with --by.")
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
    """The verdict on a valid entry of `checked`.

    Raises InputError if the entry cannot be run again: its explainer is not trusted, not installed, or fails.
    """
    entry = checked.entries[file]
    bitwise = is_same_platform(entry)
    if options.tier is Tier.recompute:
        differences = checked.recomputed[file]
        tolerance = None if bitwise else CLOSE
        apart = [each for each in differences if not agrees(each, tolerance)]
        found = _sentences(apart, "rows give")
        return Verdict(entry, options.tier, bitwise, 0, _largest(differences), found)
    rng = np.random.default_rng(options.seed)
    with ExitStack() as stack:
        policy, card = _policy(checked, entry)
        explainer, findings = _explainer(entry, options, stack)
        if card.weights_sha256 != entry.policy.weights_sha256:
            findings.append(f"the installed policy {entry.policy.name!r} has other weights than the entry's.")
        if findings:
            return Verdict(entry, options.tier, bitwise, 0, None, tuple(findings))
        episodes = None if options.tier is Tier.full else options.episodes
        again = rerun(entry, policy, card, explainer, episodes=episodes, rng=rng)
    apart = disagreeing(again.episodes, bitwise=bitwise)
    tolerance = None if bitwise else AGGREGATES
    apart += [each for each in again.aggregates if not agrees(each, tolerance)]
    found = (*again.findings, *_sentences(apart, "rerun gives"))
    return Verdict(entry, options.tier, bitwise, len(again.episodes), _largest(again.differences), found)


def verify_one(unit: tuple[Checked, str], options: Options) -> Verdict:
    """`verify` for a unit of work."""
    return verify(*unit, options)


def _sentences(apart: list[Difference], source: str) -> tuple[str, ...]:
    found = [f"{each.where} is {each.entry}, but the {source} {each.found}." for each in apart[:MAX_FINDINGS]]
    if len(apart) > MAX_FINDINGS:
        found.append(f"and {len(apart) - MAX_FINDINGS} more numbers differ.")
    return tuple(found)


def _largest(differences: list[Difference]) -> float | None:
    largest = max((each.size for each in differences), default=0.0)
    return largest if np.isfinite(largest) else None


def _policy(checked: Checked, entry: Entry) -> tuple[Policy, PolicyCard]:
    """The policy of the bundle, or else the installed one of that name."""
    name = entry.policy.name
    return checked.load_policy(name) if name in checked.policies else load_policy(find_policy(name))


def _explainer(entry: Entry, options: Options, stack: ExitStack) -> tuple[Explainer, list[str]]:
    """The explainer to run, in a sandbox unless it is ours, and where it disagrees with the entry."""
    name = entry.explainer.name if options.explainer is None else options.explainer
    if options.explainer is None and _is_ours(name):
        ours = find_explainer(name)
        return ours, list(record_findings(entry.explainer, explainer_record(ours, 0)))
    if not options.trust_code:
        raise InputError(
            f"explainer {shown(name)} is third-party code: read it, then add --trust-code to run it in a "
            f"sandbox."
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
    """Whether this distribution registers the explainer. Loads no third-party package."""
    if name in CONTROLS:
        return True
    registered = entry_points(group=EXPLAINERS, name=name)
    return bool(registered) and all(each.dist is not None and each.dist.name == OURS for each in registered)


def lines(path: Path, file: str, verdict: Verdict) -> Iterator[str]:
    """Lines to print: one per finding, or one that tells how the entry passed."""
    for finding in verdict.findings:
        yield f"{path}: {file}: {finding}"
    if not verdict.findings:
        how = "bit for bit" if verdict.bitwise else "within the tolerance of another platform"
        again = f", {verdict.episodes} episodes again" if verdict.tier is not Tier.recompute else ""
        yield (
            f"{path}: {file}: {STATUS[verdict.tier]}{again}, {how}, "
            f"largest difference {verdict.max_abs_diff}."
        )
