"""The experiments of the thesis, re-run in simulation."""
