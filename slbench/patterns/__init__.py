"""Patterns: what the projector shows, and how frames are decoded to panel coordinates.

A *code* is a part of a sequence (:mod:`slbench.patterns.base` says what it is); the families
that exist are in :data:`pattern_codes`.
"""

from slbench.patterns.base import Axis, Code, Found, Observed, Panel, Placed, Rule, Run, Variation
from slbench.patterns.decode import MIN_MODULATION_DN, Decoder, PhaseMap, decode, decoded_by
from slbench.patterns.flat import Flat
from slbench.patterns.fringes import Fringes
from slbench.patterns.fringes.ways import closest_rival
from slbench.patterns.fringes.wrong_orders import order_error_probability
from slbench.patterns.given import GivenPatterns, PatternSource, read_decoder, read_patterns
from slbench.patterns.gray import GrayCode
from slbench.patterns.matching import MatchedCode
from slbench.patterns.noise import NoiseModel
from slbench.patterns.panel import panel_response
from slbench.patterns.phase import (
    relative_phase,
    unwrap,
    unwrap_spatially,
)
from slbench.patterns.registry import pattern_codes
from slbench.patterns.sequence import Frame, PatternSequence
from slbench.rig.optics.response import Response

__all__ = [
    "MIN_MODULATION_DN",
    "Axis",
    "Code",
    "Decoder",
    "Flat",
    "Found",
    "Frame",
    "Fringes",
    "GivenPatterns",
    "GrayCode",
    "MatchedCode",
    "NoiseModel",
    "Observed",
    "Panel",
    "PatternSequence",
    "PatternSource",
    "PhaseMap",
    "Placed",
    "Response",
    "Rule",
    "Run",
    "Variation",
    "closest_rival",
    "decode",
    "decoded_by",
    "order_error_probability",
    "panel_response",
    "pattern_codes",
    "read_decoder",
    "read_patterns",
    "relative_phase",
    "unwrap",
    "unwrap_spatially",
]
