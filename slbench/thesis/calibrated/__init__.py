"""Chapters 6 and 7 measured with a rig that boards calibrated, not the one that is rendered."""
