"""Low-level files: EXR, PNG, PLY, NPZ, CSV, JSON, TOML, OpenCV YAML, and provenance.

One reader and one writer a format, each a thin layer over the library that owns it.  What
the layer adds is the same for all: writing is atomic, and a file that is missing, corrupt or
of the wrong kind raises :class:`~slbench.core.errors.InputError` in one line.  This package knows
arrays and dictionaries only; what they mean is the caller's business.
"""

from slbench.core.io.arrays import read_npz, read_ply, write_npz, write_ply
from slbench.core.io.atomic import atomic_folder, atomic_path
from slbench.core.io.images import read_colour, read_exr, read_grey, write_exr, write_png
from slbench.core.io.opencv_yaml import read_opencv_yaml, write_opencv_yaml
from slbench.core.io.provenance import provenance, write_provenance
from slbench.core.io.tables import read_table, write_table
from slbench.core.io.text import plain, read_json, read_toml, write_json, write_toml

__all__ = [
    "atomic_folder",
    "atomic_path",
    "plain",
    "provenance",
    "read_colour",
    "read_exr",
    "read_grey",
    "read_json",
    "read_npz",
    "read_opencv_yaml",
    "read_ply",
    "read_table",
    "read_toml",
    "write_exr",
    "write_json",
    "write_npz",
    "write_opencv_yaml",
    "write_ply",
    "write_png",
    "write_provenance",
    "write_table",
    "write_toml",
]
