"""The positive queries as boxes that the search of a proof begins with, one file a kind of query."""
