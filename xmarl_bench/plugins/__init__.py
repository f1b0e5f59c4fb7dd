"""Policies and explainers of every installed package, by name."""
