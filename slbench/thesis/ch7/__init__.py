"""Chapter 7: pattern sequences compared."""
