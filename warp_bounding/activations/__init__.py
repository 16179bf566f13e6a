"""What a hidden layer applies to its sums: one file an activation, with all that inference, rounding, bounds and training ask of it."""
