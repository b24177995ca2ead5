"""The public names of :mod:`slbench.bench` and where they are defined."""

from . import claims as claims
from .accept.acceptance import Acceptance as Acceptance
from .accept.acceptance import planned as planned
from .accept.folder import accept_folder as accept_folder
from .accept.standards import Standard as Standard
from .accept.verdict import Limit as Limit
from .budget.inputs import read_budget as read_budget
from .budget.result import UncertaintyBudget as UncertaintyBudget
from .budget.uncertainty import uncertainty_budget as uncertainty_budget
from .claims.check import Result as Result
from .claims.check import check_claim as check_claim
from .claims.file import Claim as Claim
from .claims.file import load_claims as load_claims
from .claims.pools import Pools as Pools
from .compare.comparison import Comparison as Comparison
from .compare.comparison import SetResult as SetResult
from .compare.sets import PatternSet as PatternSet
from .terms.measure import cloud_terms as cloud_terms
from .terms.measure import scene_terms as scene_terms
from .terms.terms import Terms as Terms
