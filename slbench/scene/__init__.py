"""Scenes: rig, objects, materials, light, detector and patterns of one measurement."""
