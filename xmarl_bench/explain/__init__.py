"""Explainers: the interface, adapters for other forms, controls, the oracle and absence models."""
