"""Networks with a threshold for each part of the domain."""
