"""One function over many units of work, in this process, in others or on a cluster."""
