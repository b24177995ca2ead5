"""Calibration targets in pictures: detect, number, re-map."""
