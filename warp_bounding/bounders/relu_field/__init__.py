"""A coarse grid of learned numbers, interpolated and cut off at 0."""
