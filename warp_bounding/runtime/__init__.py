"""How kernels are launched: cores, recorded launches, arrays in and out, compaction, progress."""
