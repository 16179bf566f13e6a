"""Arms and their cells, whose colliding configurations are bounded."""
