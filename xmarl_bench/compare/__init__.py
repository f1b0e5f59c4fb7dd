"""Explainers compared on the same policies and states."""
