"""Codes that are drawn at random."""
