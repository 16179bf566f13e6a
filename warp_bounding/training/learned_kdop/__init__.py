"""Half-spaces that are learned."""
