"""The public names of :mod:`slbench.twin` and where they are defined."""

from .experiment import Experiment as Experiment
from .experiment import run_experiment as run_experiment
