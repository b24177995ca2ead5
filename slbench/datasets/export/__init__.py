"""Data sets in other formats: frames, HDF5, BOP."""
