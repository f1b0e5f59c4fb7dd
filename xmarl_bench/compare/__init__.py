"""Compares explainers on the same policies and states."""
