"""Examples in the manner of Newton's own: ``python -m sims.newton.example_cull``."""
