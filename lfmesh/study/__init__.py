"""Studies: what the engine costs, how wrong it is, and what breaks it."""
