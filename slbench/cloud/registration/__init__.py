"""Registration of views: from the stage's nominal positions to one cloud.

:mod:`~slbench.cloud.registration.graph` has the values and the verb,
:mod:`~slbench.cloud.registration.pairs` what two views say of each other.
"""

from slbench.cloud.registration.graph import (
    STAGE_SIGMA_MM,
    STAGE_SIGMA_RAD,
    Overlap,
    Registration,
    register_views,
)

__all__ = ["STAGE_SIGMA_MM", "STAGE_SIGMA_RAD", "Overlap", "Registration", "register_views"]
