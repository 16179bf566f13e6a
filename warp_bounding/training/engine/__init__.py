"""What trains: the trainable network, its optimiser, its adversary, threads and the clock."""
