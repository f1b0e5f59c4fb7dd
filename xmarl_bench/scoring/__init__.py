"""From requests to entries: pieces of work, their measurements, and the cache of their results."""
