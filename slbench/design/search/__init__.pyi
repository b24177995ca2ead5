"""The public names of :mod:`slbench.design.search` and where they are defined."""

from .front import Front as Front
from .multisearch import minimize as minimize
