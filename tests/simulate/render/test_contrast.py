"""Contrast and phase of rendered sinusoids against the analytic transfer function.

The crown of the light transport: a plate before one real lens and one pinhole, or two real lenses;
what its pixels see of a sinusoid is known on paper.  Pixels are kept small and incommensurate with
the panel's, so that its squares average out.
"""

from dataclasses import replace

import numpy as np
import pytest
from helpers_scene import facing_rig, meet_plane, plate, scene
from stages import trace

from slbench.rig import Camera, Lens, Pose, Projector
from slbench.scene.model import SceneObject

#: mm on the object that a panel pixel covers at a numerical aperture of 0.02; it goes with 1/NA, so
#: that diffraction is of the same order in pixels.
PIXEL = 0.02
#: Camera pixels to a panel pixel.
FINER = 0.371
DISTANCE = 500.0
FREQUENCIES = np.array([1 / 100, 1 / 40, 1 / 20, 1 / 12, 1 / 8, 1 / 5])


def devices(na, wavelength, blur, which):
    """Return a camera and a projector, of which the named ones have a lens."""
    pixel = PIXEL * 0.02 / na
    pitch = 28.0 / DISTANCE * pixel
    lens = Lens(28.0, DISTANCE * na, DISTANCE, wavelength_nm=wavelength)
    pinhole = Lens(28.0, 0.0, DISTANCE)
    camera = Camera(
        90, 40, (pitch * FINER,) * 2, lens if "camera" in which else pinhole,
        blur_px=blur / FINER if "camera" in which else 0.0,
    )  # fmt: skip
    projector = Projector(
        2000, 1000, (pitch,) * 2, lens if "projector" in which else pinhole,
        blur_px=blur if "projector" in which else 0.0,
    )  # fmt: skip
    return camera, projector


def seen(camera, projector, angle, height, samples, seed=0, things=()):
    """Return what pixels see of the sinusoids, complex, over what is expected of them."""
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    plane = Pose(turn, np.array([0.0, 0.0, height]))
    view = scene(
        facing_rig(camera, projector, DISTANCE, 0.5), plate((400.0, 400.0), plane), *things
    )
    transport = trace(view, ("u",), samples=samples, seed=seed)
    points = meet_plane(*view.rig.camera.unproject(view.rig.camera.pixel_grid()), plane)
    panel = view.rig.projector.project(points)[..., 0]
    columns = np.arange(projector.width)
    white = transport.white()
    waves, expected = [], []
    for nu in FREQUENCIES:
        phase = 2 * np.pi * nu * columns
        shown = 0.5 + 0.5 * np.stack((np.cos(phase), np.sin(phase)))
        real, imaginary = 2.0 * transport.relight(shown) / white - 1.0
        waves.append((real + 1j * imaginary) * np.exp(-2j * np.pi * nu * panel))
        passed = np.sinc(nu) * np.sinc(nu * FINER)
        for device, scale in ((view.rig.projector, 1.0), (view.rig.camera, FINER)):
            passed = passed * device.spread.contrast(nu * scale, device.circle_of_confusion(points))
        expected.append(passed)
    return np.array(waves), np.array(expected)


@pytest.mark.parametrize("angle", [0.0, 0.1], ids=["facing", "tilted"])
@pytest.mark.parametrize("blur", [0.0, 1.5, 3.0])
@pytest.mark.parametrize("wavelength", [0.0, 550.0])
@pytest.mark.parametrize("na", [0.02, 0.06, 0.2])
@pytest.mark.parametrize("which", ["projector", "camera", "camera and projector"])
def test_the_transfer_function(which, na, wavelength, blur, angle):
    camera, projector = devices(na, wavelength, blur, which)
    # In focus, at a disc of 2 px, and of 7 px, whose first zero lies within these frequencies.
    for height in (0.0, 0.9, 3.6):
        waves, expected = seen(camera, projector, angle, height * (0.02 / na) ** 2, 16)
        error = waves.mean(axis=(1, 2)) - expected.mean(axis=(1, 2))
        # 1 %: levels, nodes, and 0.8 % of diffracted light laid elsewhere; of two lenses twice.
        tolerance = 0.016 if "and" in which else 0.01
        if "camera" in which:
            # Of a camera's spread points are drawn: 3,600 pixels of 16 samples each.
            tolerance += 5.0 * np.std(waves, axis=(1, 2)) / np.sqrt(waves[0].size)
        assert np.all(np.abs(error) < tolerance), (height, error)
        if which == "projector" and blur > 0.0:
            # Pixel by pixel too, where no steps of the panel's squares are left.
            np.testing.assert_allclose(waves, expected, atol=0.03)


@pytest.mark.parametrize("which", ["projector", "camera"])
def test_no_wavelength_and_no_blur_is_the_thin_lens(which):
    """Where nothing but the disc is left, first zero and sign beyond it included."""
    camera, projector = devices(0.02, 0.0, 0.0, which)
    waves, expected = seen(camera, projector, 0.0, 5.0, 64)
    assert expected[-1].mean() < -0.03  # contrast is reversed
    np.testing.assert_allclose(waves.mean(axis=(1, 2)), expected.mean(axis=(1, 2)), atol=0.01)


def occluder():
    """A small plate between plane and lenses, whose edge hides part of the projector's lens."""
    near = Pose(np.eye(3), np.array([0.75, 0.0, 40.0]))
    return plate((1.5, 60.0), near)


CASES = {
    "in focus": (0.0, ()),
    "out of focus": (3.6, ()),
    "behind an edge": (3.6, (occluder(),)),
}


@pytest.mark.parametrize("case", CASES)
def test_eight_samples_are_as_many_as_two_thousand(case):
    """Within the error that eight samples themselves state, pixel by pixel."""
    height, things = CASES[case]
    camera, projector = devices(0.02, 550.0, 1.0, "projector")
    camera = replace(camera, width=30, height=12)
    turn = Pose(np.eye(3), np.array([0.0, 0.0, height]))
    view = scene(facing_rig(camera, projector, DISTANCE, 0.5), plate((400.0, 400.0), turn), *things)
    assert all(isinstance(item, SceneObject) for item in view.objects)
    few, many = (trace(view, ("u",), samples=n, seed=3) for n in (8, 2048))
    columns = np.arange(projector.width)
    worst = []
    for nu in FREQUENCIES:
        phase = 2 * np.pi * nu * columns
        shown = 0.5 + 0.5 * np.stack((np.cos(phase), np.sin(phase)))

        def wave(transport, shown=shown):
            real, imaginary = 2.0 * transport.relight(shown) / transport.white() - 1.0
            return real + 1j * imaginary

        error = np.abs(wave(few) - wave(many))
        # One draw of the error a pixel: over all of them its mean square is known to a few per
        # cent.  Footprints' own approximations (levels, nodes, penumbrae): 0.01.
        stated = np.abs(wave(few.half()) - wave(few))
        worst.append(np.sqrt(np.mean(error**2)) / np.hypot(np.sqrt(np.mean(stated**2)), 0.01))
    assert max(worst) < 1.3, worst
