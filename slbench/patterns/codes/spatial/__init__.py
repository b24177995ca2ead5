"""Codes of one frame or a few, whose neighbours in the picture say what frames do not."""
