"""The entry: its schema, file, aggregation of rows to means, and provenance."""
