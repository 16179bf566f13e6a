"""The paper's own training beside ours in the same time, with its positional encoding and without: rows for Table 1's page."""
