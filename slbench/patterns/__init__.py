"""Patterns: what the projector shows, and how frames are decoded to panel coordinates."""

from slbench.patterns.codes import Axis, Flat, Fringes, GrayCode, Part, panel_response
from slbench.patterns.decode import MIN_MODULATION_DN, PhaseMap, decode
from slbench.patterns.phase import (
    NoiseModel,
    order_error_probability,
    relative_phase,
    unwrap,
    unwrap_spatially,
)
from slbench.patterns.sequence import Frame, PatternSequence

__all__ = [
    "MIN_MODULATION_DN",
    "Axis",
    "Flat",
    "Frame",
    "Fringes",
    "GrayCode",
    "NoiseModel",
    "Part",
    "PatternSequence",
    "PhaseMap",
    "decode",
    "order_error_probability",
    "panel_response",
    "relative_phase",
    "unwrap",
    "unwrap_spatially",
]
