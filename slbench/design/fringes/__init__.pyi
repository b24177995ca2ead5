"""The public names of :mod:`slbench.design.fringes` and where they are defined."""

from .bounded import bounded_sequence as bounded_sequence
from .design import SequenceDesign as SequenceDesign
from .design import candidates as candidates
from .design import predict as predict
from .design import thesis_sequence as thesis_sequence
from .noise import PhaseNoise as PhaseNoise
from .noise import noise_of_captures as noise_of_captures
from .unwrapping import absolute_sigma as absolute_sigma
