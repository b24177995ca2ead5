"""The public names of :mod:`slbench.design.rig` and where they are defined."""

from .constraints import Diagnosis as Diagnosis
from .constraints import explain as explain
from .constraints import margins as margins
from .evaluate import Evaluation as Evaluation
from .hardware import Hardware as Hardware
from .hardware import Placement as Placement
from .hardware import load_hardware as load_hardware
from .optimise import RigDesign as RigDesign
from .verify import Verification as Verification
