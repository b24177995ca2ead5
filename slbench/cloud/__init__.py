"""Point clouds: triangulation and registration."""
