"""How far an object, or the set of queries that meet it, reaches in a direction: certified from above."""
