"""Captures of a camera and a projector whose parameters are known."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.detector import Detector
from slbench.patterns import PatternSequence, Response

PANEL = (640, 480)


def light_of(
    sequence: PatternSequence,
    shape: tuple[int, int] = (120, 160),
    *,
    step_px: float = 0.0,
    gamma: float = 1.0,
    response: Response | None = None,
) -> NDArray[np.float64]:
    """Return the light of a plane, or of two with a step between, as a share of the brightest.

    Four panel pixels a camera pixel along each axis; `step_px` moves the right half's panel places.
    """
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    middle = (shape[1] / 2, shape[0] / 2)
    shade = 1.0 - 0.3 * ((u - middle[0]) ** 2 + (v - middle[1]) ** 2) / (
        middle[0] ** 2 + middle[1] ** 2
    )
    places = {"u": 4.0 * u + step_px * (u > middle[0]), "v": 4.0 * v}
    frames = []
    for frame in sequence.frames():
        axis = "v" if frame.along == "v" else "u"
        shown = np.clip(frame.part.profile(frame.index, sequence.size(axis)), 0.0, 1.0)
        profile = (response or Response(gamma)).light(shown)
        frames.append(shade * np.interp(places[axis], np.arange(len(profile)), profile))
    return np.array(frames)


def repeats_of(
    detector: Detector,
    patterns: str = "white+black+8@8",
    *,
    count: int = 4,
    seed: int = 0,
    level: float = 0.8,
    axes: str = "u",
    ambient: float = 0.0,
    light: NDArray[np.float64] | None = None,
    **scene: Any,
) -> dict[str, Capture]:
    """Return repeats of a capture; the brightest reaches the share `level` of saturation."""
    sequence = PatternSequence.parse(patterns, PANEL, axes=axes)
    found = light_of(sequence, **scene) if light is None else light
    photons = (found * level + ambient) * detector.saturation_e / detector.quantum_efficiency
    rng = np.random.default_rng(seed)
    return {
        f"run{k}": Capture(
            detector.expose(photons, 0.01, rng),
            sequence,
            detector.bit_depth,
            saturation_dn=detector.saturation_dn,
        )
        for k in range(count)
    }


def covered(found: Any, truth: Mapping[str, float], names: Sequence[str]) -> dict[str, bool]:
    """Return by quantity whether its interval holds the truth."""
    return {name: found[name].low <= truth[name] <= found[name].high for name in names}


def truth_of(detector: Detector) -> dict[str, float]:
    """Return what a detector's characterisation should find."""
    return {
        "gain": detector.e_per_dn,
        "read noise": detector.read_noise_e,
        "PRNU": detector.prnu,
        "DSNU": detector.dsnu_e,
        "black level": detector.black_dn,
    }
