"""Any cloud held against a scan's truth, an artefact or a mesh."""
