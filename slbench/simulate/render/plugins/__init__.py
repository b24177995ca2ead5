"""Mitsuba plugins: the thin-lens projector and the camera."""
