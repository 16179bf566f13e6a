"""Labelled queries for training: one file a kind of query."""
