"""What makes the paper's figures: the protocol of one, the run that computes them, and the tools that draw. ``figures`` has the figures themselves."""
