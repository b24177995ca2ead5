"""Compiled loops behind the evaluation of rigs, and the matrices that they work with."""
