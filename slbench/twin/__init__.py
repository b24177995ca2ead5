"""The simulated instrument beside the real one: the calibration experiment."""
