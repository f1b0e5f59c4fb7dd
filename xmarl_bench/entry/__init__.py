"""The entry: its schema, its file, how rows become means, and where it was made."""
