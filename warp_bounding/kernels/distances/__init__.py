"""How a lower bound of distances becomes a Warp function or a batch kernel, and how segments, rays and boxes are asked of it."""
