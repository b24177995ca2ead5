"""Scores: points against truth, features against certified dimensions."""
