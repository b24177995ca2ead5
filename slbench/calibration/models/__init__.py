"""Models from camera and panel coordinates to space."""
