"""What data sheets state: formulas against numbers of sheets, and by hand."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from slbench.core.errors import InputError
from slbench.rig import Lens, Projector
from slbench.scene.devices import datasheet

# -- lenses -------------------------------------------------------------------------------------


def test_a_lens_in_focus():
    # By hand: 25 * 300 / 275 = 27.27; m = 25 / 275 = 1/11; f/4 works at 4 * 12 / 11.
    assert datasheet.principal_distance_mm(25.0, 300.0) == pytest.approx(300.0 / 11.0, rel=1e-15)
    assert datasheet.working_f_number(4.0, 1.0 / 11.0) == pytest.approx(48.0 / 11.0, rel=1e-15)
    # A picture of the object's size is made at twice the focal length, with half the f-number's
    # light.
    assert datasheet.principal_distance_mm(50.0, 100.0) == 100.0
    assert datasheet.working_f_number(2.8, 1.0) == 5.6
    assert datasheet.principal_distance_mm(16.0, math.inf) == 16.0


@pytest.mark.parametrize("distance", [30.0, 453.9, 1e6, math.inf])
def test_the_focal_length_comes_back(distance):
    c = datasheet.principal_distance_mm(25.0, distance)
    # Two roundings of the quotient.
    assert datasheet.focal_length_mm(c, distance) == pytest.approx(25.0, rel=1e-14)


@pytest.mark.parametrize(
    ("distance", "words"),
    [
        (25.0, "beyond the focal length, 25 mm, got 25 mm"),
        (0.3, "got 0.3 mm; in metres it would be 300 mm"),
    ],
)
def test_no_lens_is_in_focus_within_its_focal_length(distance, words):
    with pytest.raises(InputError, match=r"focus_distance_mm: expected .*focal length") as caught:
        datasheet.principal_distance_mm(25.0, distance)
    assert words in str(caught.value)


def test_the_model_s_f_number_is_the_working_one():
    # A thin lens: its aperture is 25 / 4 mm wide, whatever it is focused on.
    c = datasheet.principal_distance_mm(25.0, 300.0)
    lens = Lens(c, 25.0 / 4.0 / 2.0, 300.0)
    working = datasheet.working_f_number(4.0, lens.magnification)
    assert lens.f_number == pytest.approx(working, rel=1e-14)


# -- sensors and panels -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sensor_format", "diagonal"),
    [
        # Effective diagonals by Basler's documentation of ace and dart cameras.
        ('1/1.2"', 13.3),
        ('1/1.8"', 8.9),
        ("1/2.3", 7.9),
        ("1/2.9", 6.3),
        ("1/3.7 inch", 4.9),
        ("1.2", 19.3),
        ("2/3", 11.0),  # the size of that format by name: 8.8 x 6.6 mm
        ("1/2", 8.0),  # 6.4 x 4.8 mm
    ],
)
def test_formats(sensor_format, diagonal):
    # Sensors of one format differ by some 3 %.
    assert datasheet.format_diagonal_mm(sensor_format) == pytest.approx(diagonal, rel=0.032)


@pytest.mark.parametrize("word", ["", "APS-C", "1/0", "16 mm", "8.9", "1/100", "-1/2"])
def test_what_is_no_format(word):
    with pytest.raises(InputError, match=r"a format such as 1/1\.8, 2/3 or 1\.1"):
        datasheet.format_diagonal_mm(word)


@pytest.mark.parametrize(
    ("micromirror", "layout", "panel", "active_mm"),
    [
        # Active areas by the data sheets; those of diamond panels end half a column beyond the
        # last one of a row, and a row beyond: a thousandth.
        (7.637, "diamond", (912, 1140), (9.855, 6.1614)),  # DLP4500
        (7.637, "diamond", (608, 684), (6.5718, 3.699)),  # DLP3000
        (5.4, "orthogonal", (854, 480), (4.6116, 2.592)),  # DLP2010
        (10.8, "orthogonal", (1024, 768), (11.059, 8.294)),  # DLP5500
        (7.56, "orthogonal", (1920, 1080), (14.5152, 8.1648)),  # DLP6500
    ],
)
def test_micromirrors(micromirror, layout, panel, active_mm):
    pitches = datasheet.micromirror_pitches_um(micromirror, layout)
    size = np.array(panel) * pitches * 1e-3
    np.testing.assert_allclose(size, active_mm, rtol=2e-3)
    # The same from the panel's own diagonal.
    found = datasheet.panel_pitches_um(float(np.hypot(*size)), *panel, layout)
    np.testing.assert_allclose(found, pitches, rtol=1e-14)


def test_a_diamond_panel_shows_16_to_10():
    u, v = datasheet.micromirror_pitches_um(7.637, "diamond")
    assert 912 * u / (1140 * v) == pytest.approx(1.6, rel=1e-14)  # 912 / 1140 * 2


# -- projectors ---------------------------------------------------------------------------------


def test_a_throw_ratio_is_distance_over_width():
    # TI of the LightCrafter: at any distance d its picture is d / 1.66 wide.
    width, height = 608 * 10.8e-3, 684 * 5.4e-3
    c = datasheet.throw_principal_distance_mm(1.66, width)
    projector = Projector(608, 684, (10.8e-3, 5.4e-3), Lens(c, 0.0, 500.0))
    corners = projector.frustum(500.0, 800.0)
    wide, tall = np.ptp(corners[:4], axis=0)[:2]
    assert wide == pytest.approx(500.0 / 1.66, rel=1e-12)
    assert tall == pytest.approx(500.0 / 1.66 * height / width, rel=1e-12)


def test_a_zoom_lens():
    # Epson EH-TW9400: focal length 22.5 to 46.7 mm, throw ratio 1.35 to 2.84, zoom 2.1; panels of
    # 0.74 inch, 16:9.  Throw ratios are stated with a tolerance of 3 %.
    width = 0.74 * 25.4 * 16.0 / math.hypot(16.0, 9.0)
    wide = datasheet.throw_principal_distance_mm(1.35, width)
    narrow = datasheet.throw_principal_distance_mm(1.35, width, zoom=2.1)
    assert wide == pytest.approx(22.5, rel=0.03)
    assert narrow == pytest.approx(46.7, rel=0.03)
    assert narrow / width == pytest.approx(2.84, rel=0.03)


@pytest.mark.parametrize(
    ("offset", "above_px"),
    [(0.0, 0.0), (100.0, 600.0), (120.0, 720.0), (40.0, 240.0), (-100.0, -600.0)],
)
def test_offsets(offset, above_px):
    # Examples of the manual of the Optoma WU1500, 1200 rows: pixels of the middle above the axis.
    row = datasheet.axis_row_px(1200, offset)
    assert row - 599.5 == pytest.approx(above_px, rel=1e-14)


def test_an_offset_of_100_per_cent_has_the_bottom_edge_on_the_axis():
    centre = ((912 - 1) / 2.0, datasheet.axis_row_px(1140, 100.0))
    projector = Projector(
        912, 1140, (10.8e-3, 5.4e-3), Lens(14.0, 0.0, 500.0), principal_point=centre
    )
    (bottom, top) = projector.unproject([[455.5, 1139.5], [455.5, -0.5]])[1]
    np.testing.assert_allclose(bottom, (0.0, 0.0, 1.0), atol=1e-15)
    assert top[1] / top[2] == pytest.approx(-1140 * 5.4e-3 / 14.0, rel=1e-12)  # y is down
    # A lens shift is in per cent of the whole height: half of it does the same.
    assert datasheet.shift_offset_percent(50.0) == 100.0


def test_the_flux_of_lumens():
    assert datasheet.radiant_flux_w(150.0) == 0.5
    assert datasheet.radiant_flux_w(683.0, lm_per_w=683.0) == 1.0  # green, by definition


# -- detectors ----------------------------------------------------------------------------------


def test_a_detector_by_decibels():
    # 40.3 dB: 10^4.03 electrons, the Poisson noise of which is a hundredth of it.
    full = datasheet.saturation_e(40.3)
    assert 20.0 * math.log10(full / math.sqrt(full)) == pytest.approx(40.3, rel=1e-14)
    noise = datasheet.dark_noise_e(full, 71.2)
    least = brentq(lambda e: e / math.sqrt(noise**2 + e) - 1.0, 0.1, 100.0, xtol=1e-12)
    assert 20.0 * math.log10(full / least) == pytest.approx(71.2, rel=1e-9)  # of the root


def test_a_range_that_no_noise_gives():
    assert datasheet.dark_noise_e(1e4, 80.0) == 0.0
    with pytest.raises(InputError, match=r"at most 80 dB.*got 81"):
        datasheet.dark_noise_e(1e4, 81.0)
