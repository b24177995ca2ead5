"""The camera's detector: from photons to digital numbers."""
