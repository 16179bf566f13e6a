"""Bounding volume hierarchies: a tree of boxes around the object's cells."""
