"""The one exception that means "what you gave me is wrong"."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input, said in one sentence: what was wrong, what was received, what to do. The CLI exits 2."""
