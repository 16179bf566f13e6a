"""What runs the rest: launches on all cores, arrays in and out, compaction, progress, files that are written whole."""

VERBOSE = "WARP_BOUNDING_VERBOSE"  # a variable of the environment: where it is set, Warp's own messages are shown
