"""Policies whose relevant messages are known by construction, and how well a mask finds them."""
