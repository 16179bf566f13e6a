"""Lower bounds of distances: one file a family; ``methods`` lists them, ``register_distance`` adds one from outside."""
