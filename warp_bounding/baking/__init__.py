"""Thousands of shapes: a bounder for each file of a folder, fitted on many processes, and a library that loads and asks them."""
