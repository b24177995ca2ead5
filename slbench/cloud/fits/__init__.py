"""Geometric elements fitted to points: least squares that survive outliers, and minimum zones.

What a coordinate measuring machine calls associated features (ISO 14405-1): a plane, a sphere, a
cylinder, a cone or a circle through measured points, by orthogonal least squares or as the
narrowest zone that holds them (ISO 1101).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
