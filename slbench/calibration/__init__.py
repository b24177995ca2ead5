"""Calibration: detect a target, re-map it to the panel, fit models of the scanner."""
