"""The commands, one file each; they import what they need when called: `--help` does not wait for torch."""
