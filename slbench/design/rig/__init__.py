"""Rig design (thesis chapter 3): where camera and projector should stand."""
