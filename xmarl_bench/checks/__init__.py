"""Checks of explainers, policies and tasks before scoring: each passes or says in a sentence why not."""

from xmarl_bench.checks.findings import Failed, Finding, NotApplicable, run_checks

__all__ = ["Failed", "Finding", "NotApplicable", "run_checks"]
