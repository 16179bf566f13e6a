"""Branch and bound: the least value of a network over boxes, from below."""
