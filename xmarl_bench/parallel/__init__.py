"""One function over many units of work, in this process, in worker processes or on a cluster."""
