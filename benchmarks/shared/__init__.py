"""What several benchmarks share: timing in turns, and rows that are kept."""
