"""Simple shapes and surfaces for transfer functions."""
