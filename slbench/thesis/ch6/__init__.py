"""Chapter 6: the rig design on a plane, a step block and three objects."""
