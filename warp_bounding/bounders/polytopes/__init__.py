"""Convex polytopes whose half-spaces are learned."""
