"""Features and dimensions that an artefact's file declares on its mesh, whatever the part."""
