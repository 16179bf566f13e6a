"""What is found without a proof: bounds of the rate of false negatives, soak tests, searches for one."""
