"""The terms that buyers compare: precision, planarity, trueness, resolution, each defined."""
