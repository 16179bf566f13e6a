"""The occupied cells as a k-d tree of bits."""
