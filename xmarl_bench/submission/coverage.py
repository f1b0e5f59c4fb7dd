"""Which explainers of a submission were scored on some of the protocol's policies only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from xmarl_bench.counted import NAMED, first_of
from xmarl_bench.entry.partial import partial_reason
from xmarl_bench.entry.schema import Entry
from xmarl_bench.plugins.names import shipped_policies
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.default_policies import default_policies


def coverage_remarks(entries: Iterable[Entry]) -> Iterator[str]:
    """A sentence for all explainers that lack whole scores on the same of the protocol's policies.

    These are the default policies among the shipped ones, in teams of the size that they were trained for.
    """
    cards = default_policies(map(load_card, shipped_policies().values()))
    scored: dict[str, set[str]] = {}
    for entry in entries:
        policy = entry.policy
        of = scored.setdefault(entry.explainer.name, set())
        if any(
            (cell.task, cell.n_agents) == (policy.task, policy.n_agents)
            and partial_reason(entry.protocol, cell) is None
            for cell in entry.results
        ):
            of.add(policy.weights_sha256)
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, of in sorted(scored.items()):
        missing = tuple(card.name for card in cards if card.weights_sha256 not in of)
        alike.setdefault(missing, []).append(name)
    for missing, names in alike.items():
        if missing:
            yield (
                f"whole scores of {first_of(names, NAMED)} are on {len(cards) - len(missing)} of the "
                f"protocol's {len(cards)} policies, none on {first_of(missing, 1)}: valid, but not ranked "
                f"over all policies."
            )
