"""Proves what a bounder claims of a mesh, and shares nothing with the library that made it: ``docs/verifier.md``."""
