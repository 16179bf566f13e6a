"""Triangles in float64 with error bounds: a hierarchy of boxes over them, and what points and boxes ask of it."""
