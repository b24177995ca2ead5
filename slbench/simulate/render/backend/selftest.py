r"""Render a scene whose every pixel is known, and compare.

A point light of intensity ``I`` at height ``h`` over the point ``s`` of a diffuse plane of
reflectance ``rho``.  The point ``x`` of the plane reflects the radiance

    L(x) = rho / pi * I cos(theta) / r^2 = rho I h / (pi (h^2 + |x - s|^2)^(3/2)),

the inverse-square and cosine laws.  A pinhole camera looks straight down.  The light stands
over a corner of the picture, so a mirrored or shifted picture fails as well as a wrong
radiance.  The light is a point: the only Monte Carlo noise is that of the place of a sample
in its pixel.
"""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.simulate.render.backend.choice import activate

TOLERANCE = 1e-3
"""Largest relative difference of a pixel.

From pixel to pixel the radiance changes by at most 1.6 %.  A pixel has 64 samples in 8 x 8
cells, each uniform in its cell, so the pixel's mean scatters by 0.016 / 8 / sqrt(12) / 8 =
7e-5: the bound stands at 14 standard deviations.  Curvature and single precision add less
than 1e-5; a picture shifted by one pixel is wrong by 1.6e-2.
"""

_SIZE = 128  # pixels each way
_SAMPLES = 64  # per pixel, a square number for the stratified sampler
_CAMERA_HEIGHT = 4.0
_HALF_WIDTH = 1.0  # of the picture, on the plane
_LIGHT = (0.5, 0.75, 1.5)
_INTENSITY = 10.0
_REFLECTANCE = 0.5


@dataclass(frozen=True)
class SelfTest:
    """Outcome of the self-test.

    Attributes
    ----------
    expected, measured : float
        Mean radiance of the picture.
    relative_difference : float
        The largest over all pixels.
    tolerance : float
        Its bound.
    seconds : float
        Time to load the scene and render it, kernels included.
    ok : bool
        Whether the bound holds.
    """

    expected: float
    measured: float
    relative_difference: float
    tolerance: float
    seconds: float
    ok: bool


def expected_radiance() -> NDArray[np.float64]:
    """Return the radiance at the centres of the pixels, shape ``(V, U)``."""
    centres = ((np.arange(_SIZE) + 0.5) / _SIZE * 2 - 1) * _HALF_WIDTH
    x, y = centres[None, :], -centres[:, None]  # v goes down where y goes up
    squared = (x - _LIGHT[0]) ** 2 + (y - _LIGHT[1]) ** 2 + _LIGHT[2] ** 2
    return _REFLECTANCE * _INTENSITY * _LIGHT[2] / (math.pi * squared**1.5)


def rendered_radiance() -> NDArray[np.float64]:
    """Return the same picture from Mitsuba, shape ``(V, U)``."""
    mi = activate()
    look_down = mi.ScalarTransform4f().look_at(
        origin=[0, 0, _CAMERA_HEIGHT], target=[0, 0, 0], up=[0, 1, 0]
    )
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "light": {"type": "point", "position": list(_LIGHT), "intensity": _INTENSITY},
            "plane": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().scale(2 * _HALF_WIDTH),
                "bsdf": {"type": "diffuse", "reflectance": _REFLECTANCE},
            },
            "camera": {
                "type": "perspective",
                "fov": math.degrees(2 * math.atan2(_HALF_WIDTH, _CAMERA_HEIGHT)),
                "to_world": look_down,
                "sampler": {"type": "stratified", "sample_count": _SAMPLES},
                "film": {
                    "type": "hdrfilm",
                    "width": _SIZE,
                    "height": _SIZE,
                    "pixel_format": "luminance",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                },
            },
        }
    )
    return np.asarray(mi.render(scene, seed=1), dtype=np.float64)[:, :, 0]


def run() -> SelfTest:
    """Render, compare, and time.

    Raises
    ------
    BackendError
        When there is no backend.
    """
    activate()
    start = time.perf_counter()
    measured = rendered_radiance()
    seconds = time.perf_counter() - start
    expected = expected_radiance()
    difference = float(np.max(np.abs(measured - expected) / expected))
    return SelfTest(
        expected=float(expected.mean()),
        measured=float(measured.mean()),
        relative_difference=difference,
        tolerance=TOLERANCE,
        seconds=seconds,
        ok=difference <= TOLERANCE,  # False for NaN
    )


def main() -> int:
    """Print the outcome as one line of JSON; exit status 0 passed, 1 failed, 2 no backend."""
    try:
        outcome = run()
    except InputError as error:
        print(json.dumps({"error": str(error)}))
        return 2
    print(json.dumps(asdict(outcome)))
    return 0 if outcome.ok else 1


if __name__ == "__main__":
    sys.exit(main())
