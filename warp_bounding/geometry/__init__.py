"""Exact and certified geometry in float64: hulls, enclosing ellipsoids, patches of directions, inverses with their error."""
