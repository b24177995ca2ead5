"""Tools that artefacts are meshed with: solids, booleans, height fields, shells, files."""
