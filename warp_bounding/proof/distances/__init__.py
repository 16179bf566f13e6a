"""Proofs of distances: that g is never above the distance to the object, by a volume that is proven, or by a search."""
