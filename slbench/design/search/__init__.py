"""Direct MultiSearch, fronts and clusters; nothing here knows of rigs."""
