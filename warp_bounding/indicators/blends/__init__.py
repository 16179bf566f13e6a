"""Meshes that deform with a few pose numbers: points of place and pose."""
