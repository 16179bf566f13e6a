"""Small networks: exact evaluation, float32 rounding, and certified bounds over boxes."""
