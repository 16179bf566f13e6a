"""What runs the rest: launches on all cores, arrays in and out, compaction, progress, files that are written whole."""
