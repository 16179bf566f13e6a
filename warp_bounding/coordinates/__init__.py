"""From the numbers of a query to those that a bounder computes with, and what each step of that rounds."""
