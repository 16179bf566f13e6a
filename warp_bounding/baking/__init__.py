"""Thousands of shapes: fits a bounder for each file of a folder on many processes; a library loads and queries them."""
