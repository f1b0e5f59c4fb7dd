"""What a referee would check of an explainer or a policy, each with a pass or a sentence."""

from xmarl_bench.checks.findings import Failed, Finding, NotApplicable, run_checks

__all__ = ["Failed", "Finding", "NotApplicable", "run_checks"]
