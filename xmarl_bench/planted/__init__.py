"""Policies whose relevant messages are known by construction, and what explainers find of them."""
