"""Networks as bounders: the paper's, with early exits, monotone ones, and the occupancy network that bounds nothing."""
