"""Virtual captures: light transport, detector frames, whole scans."""
