"""Verifies several entries, and yields each verdict as soon as it is complete.

Entries of one policy by our own explainers are scored again together, as `xmarl-bench score` does: they share
episodes, oracle and controls. Every other entry is a unit of work of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.parallel.calls import Failure, attempt
from xmarl_bench.parallel.fan_out import fan_out
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.plugins.names import is_shipped
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import Failed, score_requests
from xmarl_bench.submission.checking import Checked
from xmarl_bench.submission.rerun import compared, other_explainer, requests_of
from xmarl_bench.submission.tolerance import is_same_platform
from xmarl_bench.submission.verification import (
    Options,
    Tier,
    Verdict,
    other_weights,
    policy_of,
    verdict_of,
    verify,
)


class Unit(NamedTuple):
    """One entry to verify: the part of a path that holds it, and its file there."""

    checked: Checked
    file: str

    @property
    def entry(self) -> Entry:
        return self.checked.entries[self.file]


Outcome = tuple[int, Verdict | Failure]  # index of the unit, and the verdict or why there is none


def verify_all(units: Sequence[Unit], options: Options, workers: Workers) -> Iterator[Outcome]:
    """Verdicts in the order in which they are complete."""
    together: dict[tuple[Path | None, str, str], list[int]] = {}
    alone: list[int] = []
    for k, unit in enumerate(units):
        if options.tier is Tier.full and options.explainer is None and is_shipped(unit.entry.explainer.name):
            policy = unit.entry.policy
            bundle = unit.checked.path if policy.name in unit.checked.policies else None
            together.setdefault((bundle, policy.name, policy.weights_sha256), []).append(k)
        else:
            alone.append(k)
    for chosen in together.values():
        done = set()
        try:
            for k, outcome in _of_one_policy({k: units[k] for k in chosen}, workers):
                done.add(k)
                yield k, outcome
        except InputError:  # of one explainer, which shall not stop the others
            alone += [k for k in chosen if k not in done]
    one = partial(_verify_one, options=options)
    for index, outcome in fan_out(one, [units[k] for k in alone], workers=workers, progress="verify"):
        yield alone[index], outcome


def _verify_one(unit: Unit, options: Options) -> Verdict:
    return verify(*unit, options)


def _of_one_policy(units: dict[int, Unit], workers: Workers) -> Iterator[Outcome]:
    """Verdicts on entries of a policy by our explainers. Raises InputError as `score_requests` does."""
    first = next(iter(units.values()))
    policy, card = policy_of(first.checked, first.entry)
    explainers: dict[str, Explainer] = {}
    requests: dict[int, list[Request]] = {}
    for k, unit in units.items():
        explainer = find_explainer(unit.entry.explainer.name)
        findings = other_explainer(unit.entry, explainer) + other_weights(unit.entry, card)
        if findings:
            bitwise = is_same_platform(unit.entry)
            yield k, Verdict(unit.entry, Tier.full, bitwise, 0, None, tuple(findings))
            continue
        explainer = explainers.setdefault(explainer.name, explainer)
        found = attempt(partial(requests_of, unit.entry, policy, card, explainer))
        if isinstance(found, Failure):
            yield k, found
        else:
            requests[k] = found
    flat = [each for its in requests.values() for each in its]
    outcomes = score_requests(flat, workers=workers, progress=True)
    for k, its in requests.items():
        again = [next(outcomes) for _ in its]
        failed = next((each for each in again if isinstance(each, Failed)), None)
        if failed is not None:
            yield k, Failure(str(failed), None, InputError(str(failed)))
        else:
            scored = [each for each in again if isinstance(each, Entry)]
            yield k, verdict_of(units[k].entry, Tier.full, compared(units[k].entry, scored))
