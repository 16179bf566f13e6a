"""Coordinates in which a set of queries is a box, for the bounds of networks over rays, boxes and segments."""
