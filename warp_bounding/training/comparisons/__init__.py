"""What other losses would have learned, beside ours, for figures that show the difference. Nothing here makes a bounder."""
