"""Studies: many runs and their table: comparisons of laws, tunings; and the engine that runs them."""
