"""The public names of :mod:`slbench.score` and where they are defined."""

from .features import fit_features as fit_features
from .points import Score as Score
from .points import point_errors as point_errors
