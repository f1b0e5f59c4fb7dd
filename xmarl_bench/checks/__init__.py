"""Checks of an explainer, a policy or a task before it is scored: each passes or says in a sentence why not."""

from xmarl_bench.checks.findings import Failed, Finding, NotApplicable, run_checks

__all__ = ["Failed", "Finding", "NotApplicable", "run_checks"]
