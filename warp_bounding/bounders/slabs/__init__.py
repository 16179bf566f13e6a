"""Volumes between pairs of parallel planes: boxes, oriented boxes and k-DOPs."""
