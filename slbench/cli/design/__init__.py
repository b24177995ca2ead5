"""``slbench design``: design of rigs and pattern sequences."""
