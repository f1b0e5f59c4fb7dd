"""Third-party code in processes of its own: walls, limits, the process, and what is asked over a pipe."""
