"""From requests to entries: pieces of work, what they measure, and the cache of their results."""
