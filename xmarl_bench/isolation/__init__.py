"""Third-party code in processes of its own: walls, limits, the process, and explainers asked over a pipe."""
