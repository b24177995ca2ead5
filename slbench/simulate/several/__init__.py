"""Scenes of several cameras and projectors: captured together, measured a pair, joined."""
