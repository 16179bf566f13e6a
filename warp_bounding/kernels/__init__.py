"""How a bounding test becomes a Warp function or a batch kernel."""
