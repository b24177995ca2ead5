"""The largest box that a sweep has in focus, against dense grids of points."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.capture.focus import Focus
from slbench.core.errors import InputError
from slbench.design.rig.hardware import Sweep, load_hardware
from slbench.design.rig.volume import largest_box
from slbench.rig import Lens

MICRO = load_hardware("hardware/micro-ch8")
FIVE = tuple(np.linspace(-0.3, 0.3, 5))
CLOSE = (-0.1, -0.05, 0.0, 0.05, 0.1)
#: A rig with 50 deg between the axes, and one with 70 deg and a tilt out of the plane.
ROWS = np.array(
    [
        [15.867067, -16.504018, 0.0, -3.658853, np.deg2rad(-37.5), 0.0],
        [16.0, -22.0, 1.5, -1.0, np.deg2rad(-36.0), 0.04],
    ]
)

SWEEPS = {
    "one": Sweep((0.1,)),
    "together": Sweep(FIVE),
    "gaps": Sweep((-0.9, 0.0, 0.9)),
    "uneven": Sweep((0.3, -0.2, -0.05)),
    "apart": Sweep(FIVE, apart=True),
    "apart, gaps": Sweep((-0.9, 0.0, 0.9), apart=True),
    "camera": Sweep(FIVE, "camera"),
    "projector": Sweep(FIVE, "projector"),
}
HARDWARE = {name: replace(MICRO, sweep=sweep) for name, sweep in SWEEPS.items()}
HARDWARE["tilted"] = replace(
    HARDWARE["together"],
    camera=replace(MICRO.camera, tilt_rad=(0.1, -0.7)),
    projector=replace(MICRO.projector, tilt_rad=(0.0, 0.5)),
)
HARDWARE["telecentric"] = replace(
    HARDWARE["together"],
    camera=replace(
        MICRO.camera, lens=replace(Lens.telecentric(16.0, 0.06, 20.0), wavelength_nm=550.0)
    ),
)
HARDWARE["shallow"] = replace(HARDWARE["together"], circle_px=5.0)
HARDWARE["pinhole"] = replace(
    HARDWARE["together"], projector=replace(MICRO.projector, lens=Lens(332.0))
)


def in_focus(hardware, row, points):
    """Whether points (m, 3) are in both views, and sharp for both at some setting: one by one."""
    rig, sweep = hardware.rig(row), hardware.sweep
    focus = Focus.sweep(rig, sweep.heights_mm, sweep.move, sweep.apart)
    found = np.zeros(len(points), dtype=bool)
    for k in range(len(focus)):
        here = np.ones(len(points), dtype=bool)
        for device in focus.rig(rig, k).devices.values():
            here &= device.contains(device.project(points))
            circle = device.spread.circle(hardware.circle_px)
            here &= device.circle_of_confusion(points) <= circle
        found |= here
    return found


def brute_force(hardware, row, reach, n):
    """Return the half sizes of the largest box of grid points that are all in focus, (3,)."""
    axis = np.linspace(0.0, 1.0, n)
    x, y, z = np.meshgrid(*(axis * r for r in reach), indexing="ij")
    inside = np.ones(x.shape, dtype=bool)
    for signs in np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T:
        points = np.stack((x, y, z), axis=-1).reshape(-1, 3) * signs
        inside &= in_focus(hardware, row, points).reshape(x.shape)
    for k in range(3):
        inside = np.logical_and.accumulate(inside, axis=k)
    volume = np.where(inside, x * y * z, 0.0)
    return np.array([a.flat[np.argmax(volume)] for a in (x, y, z)])


@pytest.mark.parametrize("name", HARDWARE)
def test_largest_box_against_a_grid(name):
    hardware = HARDWARE[name]
    n = 29
    for row, box in zip(ROWS, largest_box(hardware, ROWS), strict=True):
        half = 0.5 * box
        assert half.min() > 0
        # Every point of the box is in focus at some setting ...
        axes = [np.linspace(-1.0, 1.0, 17) * h * (1 - 1e-9) for h in half]
        points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
        assert in_focus(hardware, row, points).all()
        # ... and no box of grid points is larger by more than what the grid leaves open: a step
        # a side, of the box of the grid.
        reach = 1.6 * half
        other = brute_force(hardware, row, reach, n)
        inner = np.maximum(other - reach / (n - 1), 0.0)
        assert np.prod(inner) <= np.prod(half) * (1 + 1e-3)  # what largest_box promises
        # Nor is it much smaller: it is a box of the grid, a step less a side.
        assert np.prod(other) >= np.prod(np.maximum(half - reach / (n - 1), 0.0))


def test_a_sweep_of_one_setting_is_none():
    same = replace(MICRO, sweep=Sweep((0.0,)))
    np.testing.assert_array_equal(largest_box(same, ROWS), largest_box(MICRO, ROWS))


def test_more_settings_have_more_in_focus():
    """Settings that are added to a sweep take nothing away."""
    fewer, more = (
        np.prod(largest_box(replace(MICRO, circle_px=5.0, sweep=Sweep(h)), ROWS), axis=1)
        for h in ((-0.05, 0.0, 0.05), (-0.1, -0.05, 0.0, 0.05, 0.1))
    )
    assert np.all(more >= fewer * (1 - 1e-3))
    assert np.any(more > 1.2 * fewer)


def test_apart_has_all_that_together_has():
    together, apart = (
        np.prod(
            largest_box(replace(MICRO, circle_px=5.0, sweep=Sweep(CLOSE, apart=a)), ROWS), axis=1
        )
        for a in (False, True)
    )
    assert np.all(apart > together)


def test_settings_beside_the_object_have_nothing_in_focus():
    assert np.all(largest_box(replace(MICRO, sweep=Sweep((-2.0, 2.0))), ROWS) == 0)
    # A setting behind the lens is none.
    assert np.all(largest_box(replace(MICRO, sweep=Sweep((0.0, 50.0))), ROWS) == 0)


def half_energy(waves):
    """Return the radius that holds half the light of a defocused pupil, in lambda / NA, by FFT."""
    n, radius = 1024, 64
    y, x = np.mgrid[:n, :n] - n // 2
    rho2 = (x**2 + y**2) / radius**2
    pupil = np.where(rho2 <= 1.0, np.exp(2j * np.pi * waves * rho2), 0.0)
    light = np.abs(np.fft.fftshift(np.fft.fft2(pupil))) ** 2
    distance = np.hypot(x, y).ravel() * radius / n
    order = np.argsort(distance, kind="stable")
    enclosed = np.cumsum(light.ravel()[order]) / light.sum()
    return np.interp(0.5, enclosed, distance[order])


def test_depth_of_field_is_limited_by_diffraction():
    """At its ends defocus adds to diffraction what the circle would: by the pupil's own FFT."""
    device = MICRO.rig(ROWS[0]).camera
    circle = MICRO.circle_px
    unit = device.spread.diffraction_px
    near, far = device.depth_of_field(circle)
    at_end = device.pose.to_world([0.0, 0.0, far])
    waves = device.circle_of_confusion(at_end) / (4.0 * unit)
    wanted = np.hypot(circle / np.sqrt(8.0), half_energy(0.0) * unit)
    # The FFT's pupil is 128 samples wide: its edge is known to a percent.
    assert half_energy(waves) * unit == pytest.approx(wanted, rel=0.02)
    # It is some lambda / NA^2, where a geometric disc of 20 px would have half of it.
    geometric = replace(device, lens=replace(device.lens, wavelength_nm=0.0)).depth_of_field(circle)
    rayleigh = 550e-6 / (device.lens.aperture_radius_mm / device.lens.focus_distance_mm) ** 2
    assert 1.0 < (far - near) / rayleigh < 2.0
    assert geometric[1] - geometric[0] < 0.7 * (far - near)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("focus = { settings = 0 }", "focus.settings"),
        ("focus = { heights_mm = [0.1], move = 'camera', apart = true }", "apart"),
        ("design = { camera_tilt_y_deg = [10.0, -10.0] }", "camera_tilt_y_deg"),
        ("design = { camera_tilt_y_deg = [-70.0, 0.0] }", "within 60"),
        ("design = { projector_aperture_radius_mm = [0.0, 1.0] }", "positive radii"),
        (
            "design = { camera_focus_mm = [-1.0, 1.0] }\ncamera = { focus_distance_mm = 20.0 }",
            "fixes",
        ),
    ],
)
def test_refuses_a_sweep_or_a_range_that_cannot_be(tmp_path, table, message):
    path = tmp_path / "micro.toml"
    path.write_text(f'extends = "hardware/micro-ch8"\n{table}\n')
    with pytest.raises(InputError, match=message) as error:
        load_hardware(path)
    assert "\n" not in str(error.value)


def test_the_sweep_is_the_files(tmp_path):
    path = tmp_path / "micro.toml"
    path.write_text('extends = "hardware/micro-ch8"\nfocus = { settings = 2 }\n')
    assert load_hardware(path).sweep == Sweep((0.125, -0.125))  # middles of halves of 0.5 mm
    assert load_hardware("hardware/micro-ch8").sweep is None
