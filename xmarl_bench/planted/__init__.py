"""Policies whose relevant messages are known by construction, and explainers scored against that truth."""
