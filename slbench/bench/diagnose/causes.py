"""Causes of a scanner's errors: by what they are known, where they come from, what helps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Signature:
    """What a cause leaves, what it usually is, and what to do about it.

    Parameters
    ----------
    seen : str
        How it looks.
    means : str
    remedy : str
    """

    seen: str
    means: str
    remedy: str


SIGNATURES: dict[str, Signature] = {
    "response": Signature(
        "ripple, N times the fringes",
        "the projector is not linear (gamma): N shifts take a harmonic of the fringes for phase",
        "measure the response and put its inverse into the pictures "
        "(slbench patterns write --response), or take more shifts; "
        "decode --response helps where lenses are sharp",
    ),
    "unequal light": Signature(
        "ripple, as the fringes",
        "frames of one set differ in brightness: a lamp or an exposure that is not steady, "
        "ambient light that flickers",
        "expose for whole periods of projector and mains, shut out other light; "
        "more shifts average it",
    ),
    "vibration": Signature(
        "ripple, 2 times the fringes",
        "phases are not shifted by equal steps: something moved between frames, "
        "or the projector's steps are not those stated",
        "damp or wait before the first frame, shorten the sequence; "
        "if scan after scan has the same ripple, check the steps",
    ),
    "pixels": Signature(
        "ripple, one panel pixel",
        "the projector's pixels are sharp: a sinusoid is a staircase; or a code of whole pixels",
        "defocus the projector by about a pixel, take more pixels, or fringes after the code",
    ),
    "indirect light": Signature(
        "ripple as the fringes, uneven",
        "light from other surfaces, which carries the fringes of another place: stronger near them",
        "cover or dull the surfaces around, take finer fringes in every set",
    ),
    **dict.fromkeys(
        ("ripple", "second ripple", "third ripple"),
        Signature(
            "ripple",
            "fringes or pixels of the projector: which, its period tells",
            "divide the period of your finest fringes on the object by it, or diagnose the capture",
        ),
    ),
    "bowl": Signature(
        "bowl: polynomial over the image",
        "calibration: lenses or poses; or the object's own form, which looks alike",
        "turn the object by 90 degrees: what turns with it is its form; else calibrate again",
    ),
    "orders": Signature(
        "steps of whole fringes",
        "wrong fringe orders: noise or edges of the coarser sets",
        "more light or coarser ratios of fringe counts, a lower --max-order-residual",
    ),
    "correlated": Signature(
        "streaks: neighbours err alike",
        "interreflection or scattered light, dirt, the object's own roughness or form",
        "cover what shines on the object, clean it, turn it and see what turns with it",
    ),
    "gross": Signature(
        "points off the shape",
        "points of something else, edges, saturated or dark pixels",
        "choose the object with --region, and look at `dropped` of slbench decode",
    ),
    "noise": Signature(
        "noise: neighbours err apart",
        "photons, the detector, rounding; also what is fixed to its pixels",
        "more light, more shifts or finer fringes",
    ),
}
