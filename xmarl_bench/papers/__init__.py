"""Claims of papers, tested by the harness; no part of scoring."""
