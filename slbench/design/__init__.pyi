"""The public names of :mod:`slbench.design` and where they are defined."""

from . import fringes as fringes
from . import rig as rig
from . import search as search
