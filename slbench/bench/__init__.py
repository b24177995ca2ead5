"""The bench: the thesis's experiments re-run, pattern sets compared, claims checked."""
