"""The public names of :mod:`slbench.twin` and where they are defined."""

from .content import TwinObject as TwinObject
from .experiment import Experiment as Experiment
from .experiment import run_experiment as run_experiment
from .likeness import Likeness as Likeness
from .twin import Twin as Twin
from .twin import make_twin as make_twin
from .twin import write_twin as write_twin
