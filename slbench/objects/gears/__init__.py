"""Gears and how they are measured."""
