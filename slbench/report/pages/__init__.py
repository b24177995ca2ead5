"""Pages of results, one module a kind of result."""
