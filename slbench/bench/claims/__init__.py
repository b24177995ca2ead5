"""Claims about measurements, checked with intervals."""
