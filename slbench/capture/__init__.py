"""Captures: frames and what was projected; focus stacks and their fusion."""
