"""One part measured from several viewpoints: their file, scans of all, coverage of the surface."""
