"""Reference explainers, one per file, registered through entry points like those of any other package."""
