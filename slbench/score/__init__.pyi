"""The public names of :mod:`slbench.score` and where they are defined."""

from .clouds.cloudscore import CloudScore as CloudScore
from .clouds.scored import score_cloud as score_cloud
from .clouds.scored import write_cloud_score as write_cloud_score
from .features import fit_features as fit_features
from .fusion import FusionScore as FusionScore
from .fusion import score_fusion as score_fusion
from .points import Score as Score
from .points import point_errors as point_errors
