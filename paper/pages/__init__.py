"""Pages and plots of the paper's tables."""
