"""The states that are scored, and the episodes that reach them."""
