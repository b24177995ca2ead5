"""Clouds in files of any program: PLY, E57, text, NumPy's arrays, maps of points, meshes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
