"""Small scenes and statistics shared by the rendering tests."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from slbench import objects
from slbench.patterns import PatternSequence
from slbench.rig import Camera, DesignVariables, Lens, Pose, Projector, Rig
from slbench.scene.model import Light, Scene, SceneObject

Array = NDArray[np.float64]

#: Configuration 5 of the thesis's table 4.
CONFIGURATION_5 = DesignVariables(
    756.3, -412.5, -100.0, 337.5, np.deg2rad(-18.0), np.deg2rad(10.88)
)
#: Distances from the devices to the world's origin in that configuration, mm.
CAMERA_DISTANCE, PROJECTOR_DISTANCE = 453.87, 809.78

#: Moderate lens errors: some 2 px at the corners of an 80 x 60 px image.
DISTORTION = (-0.25, 0.10, 0.002, -0.003, 0.02)
#: With a denominator that matters, and a thin prism.
RATIONAL = (0.4, -0.3, 0.002, -0.003, 0.2, 0.7, -0.2, 0.3, 0.004, -0.01, -0.003, 0.02)
TILT = (0.06, -0.04)


def camera(
    aperture: float = 0.0,
    focus: float = CAMERA_DISTANCE,
    size: tuple[int, int] = (80, 60),
    **more: Any,
) -> Camera:
    """Return the camera with a field of 4.7 mm x 3.6 mm on the sensor, f = 16 mm."""
    pitch = 80 * 0.0592 / size[0]
    return Camera(*size, (pitch, pitch), Lens(16.0, aperture, focus), **more)


def projector(
    aperture: float = 0.0,
    focus: float = PROJECTOR_DISTANCE,
    size: tuple[int, int] = (160, 120),
    vignetting: bool = True,
    **more: Any,
) -> Projector:
    """Return the projector with a panel of 6.9 mm x 5.2 mm, f = 28 mm."""
    pitch = 160 * 0.0432 / size[0]
    lens = Lens(28.0, aperture, focus, natural_vignetting=vignetting)
    return Projector(*size, (pitch, pitch), lens, **more)


def plate(size: tuple[float, float], pose: Pose | None = None) -> SceneObject:
    """Return a diffuse plate (albedo 0.7) with its top face at z = 0 of `pose`.

    It is so thin that its sides are not seen.
    """
    artefact = objects.build_artefact("plane", {"size_mm": size, "thickness_mm": 1e-3})
    return SceneObject(artefact, pose or Pose())


def scene(rig: Rig, *items: SceneObject, bounces: int = 0, samples: int = 16) -> Scene:
    """Return a scene; the sequence only fixes the panel and the coded axis."""
    panel = (rig.projector.width, rig.projector.height)
    sequence = PatternSequence.parse("1", panel)
    return Scene("test", rig, items, sequence, light=Light(bounces=bounces), samples=samples)


def step_scene(a: Camera, b: Projector, **more: Any) -> Scene:
    """Return the 5 mm step block on a plate, in configuration 5: shadows and corners."""
    below = Pose(np.eye(3), np.array([0.0, 0.0, -5.0]))
    block = SceneObject(objects.load_artefact("step-block-5"))
    return scene(
        Rig.from_design(CONFIGURATION_5, a, b), block, plate((300.0, 300.0), below), **more
    )


def facing_rig(a: Camera, b: Projector, height: float, baseline: float = 0.0) -> Rig:
    """Return a rig of two parallel devices at `height` that look straight down.

    Both have image x along the world's x; the camera is at x = `baseline`.
    """
    down = np.diag([1.0, -1.0, -1.0])
    return Rig(
        a.posed(Pose(down, np.array([baseline, 0.0, height]))),
        b.posed(Pose(down, np.array([0.0, 0.0, height]))),
    )


def meet_plane(origins: Array, directions: Array, plane: Pose) -> Array:
    """Intersect rays (..., 3) with the plane z = 0 of `plane`."""
    normal = plane.rotation[:, 2]
    step = ((plane.position - origins) @ normal) / (directions @ normal)
    return origins + step[..., None] * directions


def polygon_centroid(polygon: Array) -> Array:
    """Return the centroid of the area of a closed polygon (n, 2)."""
    x, y = (polygon - polygon.mean(axis=0)).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    moments = np.array([(x + np.roll(x, -1)) @ cross, (y + np.roll(y, -1)) @ cross])
    return moments / (3.0 * cross.sum()) + polygon.mean(axis=0)


def square_outline(centre: Array, half: float, per_side: int = 16) -> Array:
    """Return points (4 per_side, 2) along the outline of a square."""
    t = np.linspace(-1.0, 1.0, per_side, endpoint=False)
    one = np.ones_like(t)
    sides = [(t, -one), (one, t), (-t, one), (-one, -t)]
    return centre + half * np.concatenate([np.stack(side, axis=1) for side in sides])


def image_moments(image: Array) -> tuple[Array, Array]:
    """Return centroid (2,) and variance (2,) along u and v of an image's intensity."""
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    grid = np.stack((u, v), axis=-1).reshape(-1, 2)
    weight = image.ravel() / image.sum()
    mean = weight @ grid
    return mean, weight @ (grid - mean) ** 2


@dataclass(frozen=True)
class Agreement:
    """Outcome of the comparison of two sets of independent noisy images.

    Attributes are p-values under the hypothesis of equal expectations: of the worst pixel
    (Bonferroni-corrected for the number of pixels), and of the mean over the image.
    """

    pixels: float
    mean: float

    @property
    def p(self) -> float:
        """p-value of both tests together (Bonferroni)."""
        return min(1.0, 2.0 * min(self.pixels, self.mean))


def agreement(first: Array, second: Array) -> Agreement:
    """Test whether two stacks (repeats, V, U) of images have the same expectation.

    Welch's t-test on every pixel and on the image's mean; repeats must be independent.  The
    repeats are themselves means of many samples, so that t's tails are good where it counts;
    where a pixel is seldom hit the test is conservative (one odd repeat gives t = 1).
    """
    dark = (first.max(axis=0) == 0) & (second.max(axis=0) == 0)
    p = stats.ttest_ind(first[:, ~dark], second[:, ~dark], axis=0, equal_var=False).pvalue
    mean = stats.ttest_ind(first.mean(axis=(1, 2)), second.mean(axis=(1, 2)), equal_var=False)
    return Agreement(min(1.0, float(p.min()) * p.size), float(mean.pvalue))


def with_bounces(value: Scene, bounces: int) -> Scene:
    """Return the scene with interreflections."""
    return replace(value, light=Light(bounces=bounces))
