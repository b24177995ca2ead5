"""A scene measured while keys of it go through values."""
