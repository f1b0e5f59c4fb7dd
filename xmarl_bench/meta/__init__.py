"""Do the metrics measure what they say? Tests of them on truth that is known or degraded in known steps."""
