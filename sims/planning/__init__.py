"""Planning with a broad phase, in any number of dimensions: what the demos ``path`` and ``arm`` share."""
