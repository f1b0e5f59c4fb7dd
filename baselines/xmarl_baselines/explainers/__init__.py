"""Reference explainers, one per file. They register through the entry points that anyone else's use."""
