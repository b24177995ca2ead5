"""Chapter 3: the rig optimiser by the configurations that it chose."""
