"""A built board's values by metric, explainer and policy, and paired differences between explainers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.board.entry_rows import is_whole, newest
from xmarl_bench.metrics.statistics import Difference, over_runs
from xmarl_bench.metrics.student import Design


def overall_ranking(board: dict[str, Any]) -> dict[str, Any]:
    """The ranking over all tasks and team sizes, by enumerated oracles."""
    (ranking,) = (
        each for each in board["rankings"] if each["task"] is None and each["oracle"] == "enumerated"
    )
    found: dict[str, Any] = ranking
    return found


@dataclass(frozen=True)
class Scores:
    """The board's values, of the policies that a ranking compares."""

    ranking: dict[str, Any]
    tables: list[dict[str, Any]]  # measured as the ranking's are
    policies: list[dict[str, Any]]
    values: dict[str, dict[str, dict[str, float]]]  # metric -> explainer or control -> policy

    @classmethod
    def of(cls, board: dict[str, Any], ranking: dict[str, Any] | None = None) -> Scores:
        """ranking: one of the board's; by default that over all tasks and team sizes."""
        ranking = overall_ranking(board) if ranking is None else ranking
        alike = ("protocol", "oracle")
        tables = [each for each in board["tables"] if all(each[key] == ranking[key] for key in alike)]
        compared = {(each["name"], each["n_agents"]) for each in ranking["policies"]}
        policies: list[dict[str, Any]] = []
        values: dict[str, dict[str, dict[str, float]]] = {}
        for table in tables:
            for policy in table["policies"]:
                if not is_whole(policy) or (policy["name"], table["n_agents"]) not in compared:
                    continue
                policies.append({**policy, "task": table["task"], "n_agents": table["n_agents"]})
                for row in newest(policy["rows"]).values():
                    for metric, summary in row["metrics"].items():
                        if summary is not None and summary["value"] is not None:
                            of_metric = values.setdefault(metric, {})
                            of_metric.setdefault(row["explainer"], {})[policy["name"]] = summary["value"]
        return cls(ranking, tables, policies, values)

    def only(self, keep: Callable[[dict[str, Any]], bool]) -> Scores:
        """The scores on some of the policies."""
        return replace(self, policies=[policy for policy in self.policies if keep(policy)])

    @property
    def explainers(self) -> list[str]:
        """Ranked, best first."""
        return [row["explainer"] for row in self.ranking["rows"] if row["rank"] is not None]

    @property
    def tied(self) -> list[str]:
        """Explainers without a significant difference to the best, which is the first of them."""
        return [row["explainer"] for row in self.ranking["rows"] if row["ties_first"]]

    def of_policies(self, metric: str, name: str) -> list[float]:
        """One value for each policy; NaN if it was not measured."""
        found = self.values.get(metric, {}).get(name, {})
        return [found.get(policy["name"], float("nan")) for policy in self.policies]

    @property
    def design(self) -> Design:
        """Of the policies, as in the ranking."""
        return Design(
            clusters=tuple(policy["training"] for policy in self.policies),
            cells=tuple((policy["task"], policy["n_agents"]) for policy in self.policies),
        )

    def mean(self, metric: str, name: str) -> float:
        """Raises ValueError if no policy has a value."""
        value = self.difference(metric, name).value
        if value is None:
            raise ValueError(f"{name} has no {metric} on the policies of this ranking.")
        return value

    def difference(self, metric: str, a: str, b: str | None = None) -> Difference:
        """Mean over cells of the mean over their trainings of a less b, or of a alone."""
        return self.difference_over((metric,), a, b)

    def difference_over(self, metrics: Sequence[str], a: str, b: str | None = None) -> Difference:
        """`difference` of a policy's mean over several metrics."""

        def mean_of(name: str) -> NDArray[np.float64]:
            return np.asarray(np.mean([self.of_policies(metric, name) for metric in metrics], axis=0))

        ours = mean_of(a)
        theirs = np.zeros_like(ours) if b is None else mean_of(b)
        return over_runs([[x] for x in ours], [[y] for y in theirs], design=self.design)
