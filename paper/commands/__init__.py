"""The commands that make the paper's tables and figures."""
