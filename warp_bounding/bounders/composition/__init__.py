"""Bounders made of bounders by *and* and *or*."""
