"""Submissions by third parties: packed, checked without running anything, and optionally run again."""
