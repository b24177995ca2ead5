"""Where light lands: single pixels, single features, blur discs, tilted planes in focus.

Everything is compared with the double-precision geometry of :mod:`slbench.rig`, through the
light transport tracer and through Mitsuba's own integrators with our plugins.
"""

from dataclasses import replace

import numpy as np
import pytest
from helpers_scene import (
    CONFIGURATION_5,
    DISTORTION,
    RATIONAL,
    TILT,
    camera,
    facing_rig,
    image_moments,
    meet_plane,
    plate,
    polygon_centroid,
    projector,
    scene,
    square_outline,
)
from scipy.spatial.transform import Rotation
from stages import trace

from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.simulate.render.mitsuba import mi
from slbench.simulate.render.translate import mitsuba_dict

ERRORS = {"distortion": DISTORTION, "tilt_rad": TILT}
OFF_CENTRE = {"principal_point": (70.3, 66.8)}


def panel_images(scene_, panels, way):
    """Return images (n, V, U) under panel images (n, H, W), by the tracer or by Mitsuba."""
    if way == "tracer":
        return trace(scene_, ("uv",)).relight_images(panels).astype(np.float64)
    loaded = [mi.load_dict(mitsuba_dict(scene_, panel)) for panel in panels]
    images = [mi.render(item, seed=0).numpy()[..., 0].astype(np.float64) for item in loaded]
    camera_ = scene_.rig.camera
    return np.array(images) * camera_.relative_illumination(camera_.pixel_grid())


def white_panel(device):
    return np.ones((device.height, device.width))


def centroid_tolerance(outline):
    """Return how well an image's centroid gives the centroid of a lit outline, px.

    Light in a pixel counts at the pixel's centre, not where in it it falls: of a part `a` of
    the pixel that is `a (1 - a) / 2 <= 1/8` px, at the two edges of the spot, over its width.
    Monte Carlo noise: the pixels along an outline of 50 px have standard deviations of at most
    1/16 each at 64 samples, with a lever of half a width, over the area: 0.01 px, times four.
    """
    width = np.ptp(outline, axis=0).min()
    assert width > 7.0
    return 0.25 / width + 0.04


def one_pixel(device, u, v):
    lit = np.zeros((device.height, device.width))
    lit[v, u] = 1.0
    return lit


# -- one panel pixel, one feature --------------------------------------------------------

# (camera, projector); with 16 x 12 panel pixels each covers some 12 camera pixels.
RIGS = {
    "stock plugins": (
        camera(size=(160, 120)),
        projector(size=(16, 12), vignetting=False),
    ),
    "apertures": (camera(2.0, size=(160, 120)), projector(5.6, size=(16, 12))),
    "camera distorted": (camera(size=(160, 120), **ERRORS), projector(size=(16, 12))),
    "all of OpenCV's": (
        camera(size=(160, 120), distortion=RATIONAL, tilt_rad=TILT),
        projector(size=(16, 12), distortion=RATIONAL),
    ),
    "projector distorted": (camera(size=(160, 120)), projector(size=(16, 12), **ERRORS)),
    "telecentric, both tilted": (
        replace(camera(size=(160, 120), tilt_rad=TILT), lens=Lens.telecentric(0.04, 0.004, 453.87)),
        replace(
            projector(size=(16, 12), tilt_rad=TILT), lens=Lens.telecentric(0.04, 0.006, 809.78)
        ),
    ),
    "both, and off centre": (
        camera(2.0, size=(160, 120), **ERRORS, **OFF_CENTRE),
        projector(5.6, size=(16, 12), principal_point=(8.1, 5.2), **ERRORS),
    ),
    "lens shift": (
        camera(size=(160, 120)),
        projector(5.6, size=(16, 12), principal_point=(7.3, 13.4), distortion=RATIONAL),
    ),
}
TARGET = Pose(np.eye(3), np.array([0.0, 0.0, 3.0]))


def placed(name):
    """Return a rig; a shifted lens has its axis beside the panel, whose middle looks ahead."""
    rig = Rig.from_design(CONFIGURATION_5, *RIGS[name])
    if name != "lens shift":
        return rig
    device = rig.projector
    middle = (0.5 * (device.width - 1), 0.5 * (device.height - 1))
    ray = np.append(device.normalise(middle), 1.0)
    turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [ray])[0].as_matrix()
    pose = Pose(device.pose.rotation @ turn, device.pose.position)
    return rig.having(projector=device.posed(pose))


@pytest.mark.parametrize("way", ["tracer", "mitsuba"])
@pytest.mark.parametrize("name", RIGS)
def test_one_panel_pixel_appears_where_geometry_says(name, way):
    rig = placed(name)
    scene_ = scene(rig, plate((400.0, 400.0), TARGET), samples=64)
    # Neither is the mirror image of the other, nor on a diagonal.
    lit = [(6, 4), (10, 6)]
    panels = [one_pixel(rig.projector, u, v) for u, v in lit]
    *images, white = panel_images(scene_, np.array([*panels, white_panel(rig.projector)]), way)
    for (u, v), image in zip(lit, images, strict=True):
        outline = square_outline(np.array([u, v], float), 0.5)
        seen = rig.camera.project(meet_plane(*rig.projector.unproject(outline), TARGET))
        assert rig.camera.contains(seen).all()
        # The share of each camera pixel that the panel pixel covers, free of any fall-off.
        found, _ = image_moments(image / white)
        tolerance = centroid_tolerance(seen)
        np.testing.assert_allclose(found, polygon_centroid(seen), atol=tolerance)
        # Without the outline: the chief ray of the pixel's centre.  Perspective moves the
        # centroid of a square off its centre by some 0.1 px.
        ray = rig.projector.unproject(np.array([u, v], float))
        np.testing.assert_allclose(found, rig.camera.project(meet_plane(*ray, TARGET)), atol=0.2)


@pytest.mark.parametrize("way", ["tracer", "mitsuba"])
@pytest.mark.parametrize("name", RIGS)
def test_a_small_feature_appears_where_geometry_says(name, way):
    """A small lit square in an otherwise empty world."""
    rig = placed(name)
    place = Pose(np.eye(3), np.array([22.0, 9.0, 3.0]))
    panel = white_panel(rig.projector)[None]
    (image,) = panel_images(scene(rig, plate((10.0, 10.0), place), samples=64), panel, way)
    (full,) = panel_images(scene(rig, plate((400.0, 400.0), place), samples=64), panel, way)
    corners = square_outline(np.zeros(2), 5.0)
    seen = rig.camera.project(place.to_world(np.column_stack((corners, np.zeros(len(corners))))))
    found, _ = image_moments(image / full)
    np.testing.assert_allclose(found, polygon_centroid(seen), atol=centroid_tolerance(seen))


# -- defocus -----------------------------------------------------------------------------


def pixel_mm(device, distance):
    """Return the side of a pixel in a facing plane."""
    focus = device.lens.focus_distance_mm
    scale = 1.0 if device.lens.kind == "telecentric" else distance / focus
    return device.pitch_mm[0] / device.lens.magnification * scale


def sharp(device):
    return replace(device, lens=replace(device.lens, aperture_radius_mm=0.0))


OPTICS = {
    "perspective": Lens(16.0, 6.0, 400.0),
    "telecentric": Lens.telecentric(0.04, 0.015, 400.0),
}


@pytest.mark.parametrize("way", ["tracer", "mitsuba"])
@pytest.mark.parametrize("distance", [300.0, 550.0])
@pytest.mark.parametrize("who", ["camera", "projector"])
@pytest.mark.parametrize("kind", OPTICS)
def test_blur_disc_has_the_thin_lens_diameter(kind, who, distance, way):
    """One device has an aperture, the other is a pinhole; both face a plane out of focus.

    Variances add: a uniform disc of diameter D has D^2 / 16 along each axis, the panel pixel
    and the camera pixel have a twelfth of the squares of their sides.
    """
    a = Camera(80, 60, (0.015, 0.015), OPTICS[kind])
    b = Projector(40, 30, (0.08, 0.08), OPTICS[kind])
    blurred = {"camera": a, "projector": b}[who]
    a, b = (device if device is blurred else sharp(device) for device in (a, b))
    scene_ = scene(facing_rig(a, b, distance), plate((400.0, 400.0)), samples=512)
    (image,) = panel_images(scene_, one_pixel(b, 21, 14)[None], way)
    _, variance = image_moments(image)
    squares = pixel_mm(b, distance) ** 2 + pixel_mm(a, distance) ** 2
    diameter = 4.0 * np.sqrt(variance * pixel_mm(a, distance) ** 2 - squares / 12.0)
    # In words: the cone through the aperture, cut by the plane.
    focus, radius = blurred.lens.focus_distance_mm, blurred.lens.aperture_radius_mm
    expected = 2.0 * radius * abs(distance - focus) / focus
    # Some 15 000 samples hit the disc; the relative error of their variance is 1/sqrt of that
    # (kurtosis 2), of the diameter half as much: 0.4 %, times five.
    np.testing.assert_allclose(diameter, expected, rtol=0.02)
    # And as the rig has it, in pixels; the device's own frame is the world's here.
    circle = blurred.circle_of_confusion(np.array([0.0, 0.0, distance]))
    assert circle == pytest.approx(expected / pixel_mm(blurred, distance), rel=1e-12)


# -- tilted planes in focus (Scheimpflug) -------------------------------------------------


def row_spread(scene_):
    """Return the standard deviation (V, U) of each camera pixel's light on the panel, in u."""
    transport = trace(scene_, ("u",), seed=2)
    rows = transport.marginals["u"].tocsr().astype(np.float64)
    u = np.arange(transport.panel[0])
    total = rows.sum(axis=1)
    total[total == 0.0] = np.nan  # pixels that see nothing of the panel
    mean = rows @ u / total
    return np.sqrt(np.maximum(rows @ u**2 / total - mean**2, 0.0)).reshape(transport.shape)


def plane_in_focus(device):
    """Return the pose of a plate whose top face is the plane in focus, at the optical axis."""
    z = device.pose.rotation @ -device.focus_plane
    z /= np.linalg.norm(z)
    y = np.cross(z, [1.0, 0.0, 0.0])
    y /= np.linalg.norm(y)
    centre = device.pose.to_world([0.0, 0.0, device.lens.focus_distance_mm])
    return Pose(np.stack((np.cross(y, z), y, z), axis=1), centre)


@pytest.mark.parametrize("tilt", [(0.0, 0.17), (0.12, -0.10)])
@pytest.mark.parametrize("who", ["camera", "projector"])
@pytest.mark.parametrize("lens", [Lens(50.0, 15.0, 200.0), Lens.telecentric(0.25, 0.075, 200.0)])
def test_a_tilted_panel_focuses_on_a_tilted_plane(lens, who, tilt):
    """A plate in the computed plane in focus is sharp all over; untilted it is not.

    Sharpness is how widely a camera pixel's light spreads on the panel, beside a pinhole's.
    """
    a = Camera(80, 60, (0.05, 0.05), lens)
    b = Projector(1000, 800, (0.005, 0.005), lens)

    def spread(aperture, tilted):
        chosen = {"camera": a, "projector": b}[who]
        devices = [
            replace(
                sharp(device) if device is not chosen or not aperture else device,
                tilt_rad=tilt if device is chosen and tilted else (0.0, 0.0),
            )
            for device in (a, b)
        ]
        rig = facing_rig(*devices, 200.0)
        posed = {"camera": rig.camera, "projector": rig.projector}[who]
        on_plate = meet_plane(*rig.camera.unproject(rig.camera.pixel_grid()), pose)
        seen = rig.projector.contains(rig.projector.project(on_plate))
        assert seen.mean() > 0.9
        values = row_spread(scene(rig, plate((60.0, 60.0), pose), samples=144))
        return np.where(seen, values, np.nan), posed.circle_of_confusion(on_plate)

    aimed = facing_rig(replace(a, tilt_rad=tilt), replace(b, tilt_rad=tilt), 200.0)
    pose = plane_in_focus({"camera": aimed.camera, "projector": aimed.projector}[who])
    # The plate is well out of parallel with the panel.
    assert np.degrees(np.arccos(pose.rotation[2, 2])) > 25.0

    pinhole, _ = spread(aperture=False, tilted=True)
    tilted, no_circle = spread(aperture=True, tilted=True)
    untilted, circle = spread(aperture=True, tilted=False)
    # Sharp to the Monte Carlo error of a spread from 144 stratified samples, some 0.1 %, of
    # which this allows the extremes over 4800 pixels.
    assert no_circle.max() < 1e-9
    assert 0.99 < np.nanmin(tilted / pinhole) < np.nanmax(tilted / pinhole) < 1.01
    assert np.nanmax(untilted / pinhole) > 3.0
    if who == "projector":
        # A uniform disc of diameter D has the standard deviation D / 4; D is taken at the
        # pixel's centre, and the plate slants within a pixel.
        far = (circle > 10.0) & np.isfinite(pinhole)
        disc = 4.0 * np.sqrt(untilted[far] ** 2 - pinhole[far] ** 2)
        np.testing.assert_allclose(np.median(disc / circle[far]), 1.0, atol=0.01)
