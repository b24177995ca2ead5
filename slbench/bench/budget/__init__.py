"""Error budgets: every source of error of a scene switched on alone."""
