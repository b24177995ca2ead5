"""The public names of :mod:`slbench.cloud.fits` and where they are defined."""

from .geometry import Circle as Circle
from .geometry import Cone as Cone
from .geometry import Cylinder as Cylinder
from .geometry import Element as Element
from .geometry import Plane as Plane
from .geometry import Sphere as Sphere
from .geometry import elements as elements
from .squares import Fit as Fit
from .squares import fit_element as fit_element
from .zones import minimum_zone as minimum_zone
