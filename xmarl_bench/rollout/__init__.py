"""Which states are scored, and the episodes that a team plays to reach them."""
