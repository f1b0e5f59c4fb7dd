"""Tasks: what the harness needs of one, where they are found, and PettingZoo environments as tasks."""
