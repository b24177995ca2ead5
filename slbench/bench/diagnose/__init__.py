"""What the errors of a measured plane or sphere come from."""
