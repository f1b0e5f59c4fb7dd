"""JSON files: written atomically, read strictly."""
