"""Flat targets for calibration: dots, circles, squares."""
