"""Pictures of values: asked for by the value, found by its type."""

import itertools
from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from datasets_small import result_of
from matplotlib.figure import Figure

import slbench as sl
from slbench.core import registry
from slbench.core.registry import resolved
from slbench.core.show.display import length_unit
from slbench.core.show.drawing import figure, write_figure
from slbench.report.plots import DRAWERS
from slbench.report.plots.relief import (
    View,
    scattered_normals,
    shading,
    surface_image,
    upward_normals,
)


@pytest.fixture(scope="module")
def scan():
    return result_of(1)


def images(drawn):
    """Return the images of a figure, those of colour bars left out."""
    found = [one for axes in drawn.axes for one in axes.images]
    return [one.get_array() for one in found if one.get_gid() != "bar"]


def test_every_row_names_a_type_and_its_drawer():
    for kind, drawer in DRAWERS.items():
        assert isinstance(resolved(kind), type)
        assert callable(resolved(kind).plot)
        assert callable(resolved(drawer))


def test_a_capture_shows_its_frames(scan):
    drawn = scan.capture.plot()
    assert isinstance(drawn, Figure)
    for shown, frame in zip(images(drawn), scan.capture.frames, strict=True):
        np.testing.assert_array_equal(shown, frame)


def test_of_many_frames_an_even_choice_is_shown(scan):
    many = replace(
        scan.capture,
        frames=np.repeat(scan.capture.frames, 5, axis=0),
        sequence=sl.PatternSequence.parse("1,2,4,8,16@6", scan.capture.sequence.panel),
    )
    titles = [axes.get_title() for axes in many.plot().axes if axes.images]
    assert len(titles) == 12
    assert (titles[0], titles[-1]) == ("frame 0", "frame 29")


def test_a_phase_map_shows_coordinate_deviation_and_modulation(scan):
    coordinate, deviation, modulation = images(scan.phase.plot())
    np.testing.assert_array_equal(coordinate.filled(np.nan), scan.phase.coordinate["u"])
    np.testing.assert_array_equal(deviation.filled(np.nan), scan.phase.sigma["u"])
    np.testing.assert_array_equal(modulation, scan.phase.modulation)


def test_a_cloud_shows_heights_and_its_points(scan):
    drawn = scan.cloud.plot()
    height, _ = images(drawn)
    assert np.count_nonzero(np.isfinite(height.filled(np.nan))) == len(scan.cloud)
    above = next(axes for axes in drawn.axes if "from above" in axes.get_title())
    (dots,) = above.collections
    assert len(dots.get_offsets()) == len(scan.cloud)
    # The highest is drawn last, over the others.
    assert dots.get_array()[-1] == scan.cloud.points[:, 2].max()


def test_a_cloud_without_points_can_be_drawn(scan):
    none = replace(
        scan.cloud,
        points=scan.cloud.points[:0],
        pixels=scan.cloud.pixels[:0],
        sigma_px=scan.cloud.sigma_px[:0],
        sensitivity=scan.cloud.sensitivity[:0],
    )
    none.plot().canvas.draw()


def test_patterns_show_a_profile_a_frame():
    sequence = sl.PatternSequence.parse("white+gray+8@4", (64, 32), axes="uv")
    drawn = sequence.plot()
    for shown, axis in zip(images(drawn), "uv", strict=True):
        np.testing.assert_array_equal(shown, sequence.profiles(axis)[1])


def test_a_stack_shows_a_frame_a_setting(scan):
    dark = replace(scan.capture, frames=scan.capture.frames // 2)
    stack = sl.FocusStack([scan.capture, dark], sl.capture.Focus({"camera": (400.0, 410.0)}))
    first, second = images(stack.plot())
    np.testing.assert_array_equal(first, scan.capture.frames[0])
    np.testing.assert_array_equal(second, scan.capture.frames[0] // 2)
    assert "camera 400 mm" in stack.plot().axes[0].get_title()


def texts(drawn, kind):
    """Return the texts of a kind on a sheet, as they are read."""
    return [one.get_text() for one in drawn.axes[0].texts if one.get_gid() == kind]


def overlaps(drawn):
    """Return the pairs of texts of a sheet whose boxes share more than a pixel, once drawn."""
    drawn.canvas.draw()
    shown = [one for one in drawn.axes[0].texts if one.get_text()]
    boxes = [one.get_window_extent() for one in shown]
    return [
        (a.get_text(), b.get_text())
        for (a, box_a), (b, box_b) in itertools.combinations(zip(shown, boxes, strict=True), 2)
        if min(box_a.x1, box_b.x1) - max(box_a.x0, box_b.x0) > 1.0
        and min(box_a.y1, box_b.y1) - max(box_a.y0, box_b.y0) > 1.0
    ]


def cut_off(drawn):
    """Return the texts of a sheet that reach beyond it."""
    drawn.canvas.draw()
    width, height = drawn.canvas.get_width_height()
    return [
        one.get_text()
        for one in drawn.axes[0].texts
        for box in [one.get_window_extent()]
        if one.get_text()
        and not (box.x0 > -1 and box.y0 > -1 and box.x1 < width + 1 and box.y1 < height + 1)
    ]


def test_a_scan_draws_its_summary(scan):
    drawn = scan.plot()
    # Four of what was seen, shape in colours, heights, errors; the eighth is a histogram.
    frame, phase, coordinate, modulation, shape, height, error = images(drawn)
    np.testing.assert_array_equal(frame, scan.capture.frames[3])
    np.testing.assert_array_equal(coordinate.filled(np.nan), scan.phase.coordinate["u"])
    np.testing.assert_array_equal(modulation, scan.phase.modulation)
    assert np.nanmax(phase) <= 2 * np.pi
    assert shape.shape[2] == 4
    # The block is higher than a millimetre, its errors are not.
    z = scan.cloud.image(scan.cloud.points[:, 2])
    np.testing.assert_allclose(height.filled(np.nan), z)
    truth = scan.truth.point[..., 2]
    assert np.nanmax(np.abs(error.filled(np.nan) - 1e3 * (z - truth))) < 1e-6
    assert texts(drawn, "unit") == ["DN", "rad", "px", "DN", "mm", "µm"]
    assert [name for name in texts(drawn, "label") if name[0] in "xyzh"] == [
        *("x / mm", "y / mm", "z / mm"),
        "height error / µm",
    ]
    assert "median error" in texts(drawn, "title")[-1]


@pytest.mark.parametrize(
    ("scene", "patterns"),
    [("step-block", ("gray+8@4", 3, "uv")), ("ch8-coin-3", None), ("plane", ("gray", 3, "u"))],
)
def test_texts_of_a_summary_have_room(scene, patterns):
    # Macro and micro rigs, oblong and square sensors, one axis and two, with and without fringes.
    loaded = sl.load_scene(scene, preview=True)
    if patterns is not None:
        loaded = loaded.with_patterns(*patterns)
    drawn = sl.scan(loaded, samples=2).plot()
    assert overlaps(drawn) == []
    assert cut_off(drawn) == []
    if scene == "ch8-coin-3":
        # 60 um high on a field of half a millimetre: one unit for both, and for the errors.
        assert texts(drawn, "unit")[-2:] == ["µm", "µm"]
        assert "z / µm" in texts(drawn, "label")


def test_equal_figures_are_equal_files(scan, tmp_path):
    for name in ("a.png", "b.png"):
        write_figure(scan, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    # Nothing in it names the library or the time.
    assert b"Software" not in (tmp_path / "a.png").read_bytes()


class Other:
    """A value of another package."""


def draw_other(value):
    return value


def test_other_packages_add_drawers(monkeypatch):
    name, drawer = f"{__name__}:Other", f"{__name__}:draw_other"
    point = EntryPoint(name, drawer, "slbench.drawers")
    monkeypatch.setattr(registry, "_installed", lambda group: {name: [point]})
    value = Other()
    assert figure(value) is value


def test_a_value_without_a_drawer_is_refused():
    with pytest.raises(sl.InputError, match="plot: expected a value that has a drawer, got Other"):
        figure(Other())


# -- shaded surfaces ------------------------------------------------------------------------------


def roof(count, rng):
    """Return points of a roof of 30 deg about the y axis, and the upward normals of its sides."""
    x, y = rng.uniform(-10.0, 10.0, (2, count))
    slope = np.tan(np.pi / 6.0)
    normals = np.column_stack((np.sign(x) * slope, np.zeros(count), np.ones(count)))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.column_stack((x, y, -slope * np.abs(x))), normals


def test_normals_of_scattered_points_are_the_surfaces():
    points, normals = roof(4000, np.random.default_rng(3))
    found = scattered_normals(points)
    away = np.abs(points[:, 0]) > 1.5  # sixteen neighbours reach some 0.7 mm
    np.testing.assert_allclose(found[away], normals[away], atol=1e-9)


def test_normals_of_an_image_are_the_surfaces():
    u, v = np.meshgrid(np.arange(60.0), np.arange(40.0))
    plane = np.stack((0.1 * u, -0.1 * v, 0.02 * u - 0.05 * v), axis=-1)
    found = upward_normals(plane)
    normal = np.array((-0.2, -0.5, 1.0)) / np.linalg.norm((-0.2, -0.5, 1.0))
    # In float32, with a side of some 0.4 mm between the ends of a difference.
    np.testing.assert_allclose(
        found[5:-5, 5:-5].reshape(-1, 3), normal[None] + np.zeros((1500, 3)), atol=1e-5
    )


def test_shade_is_one_where_level_and_darker_away_from_the_light():
    level, to_light, away = np.eye(3)[2], np.array((-0.5, 0.0, 0.87)), np.array((0.9, 0.0, 0.44))
    level_shade, bright, dark = shading(np.stack((level, to_light, away)))
    assert level_shade == pytest.approx(1.0)
    assert bright > 1.0 > dark
    assert shading(np.full((1, 3), np.nan)) == pytest.approx(1.0)


def test_points_that_fill_a_volume_have_no_shade():
    rng = np.random.default_rng(4)
    grid = np.stack(np.meshgrid(*[np.arange(10.0)] * 3), axis=-1).reshape(-1, 3)
    for points in (grid + rng.normal(0.0, 1e-4, grid.shape), rng.uniform(0.0, 1.0, (3000, 3))):
        assert np.isnan(scattered_normals(points)).all()


def test_the_nearest_point_hides_those_behind_it():
    box = np.array(((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)))
    view = View.of(box, 60.0, 60.0)
    sight = view.towards
    points = np.array((0.3 * sight, -0.3 * sight))
    red, blue = np.eye(3)[0], np.eye(3)[2]
    for order in ((0, 1), (1, 0)):
        image = surface_image(points[list(order)], np.array((red, blue))[list(order)], view, 60, 60)
        shown = image[image[..., 3] > 0.9]
        assert len(shown)
        np.testing.assert_allclose(shown[:, :3], red[None] + np.zeros((len(shown), 3)), atol=1e-6)


def test_units_fit():
    assert [length_unit(v).name for v in (25.0, [0.06, 0.01], 3e-5, np.nan, 0.0)] == [
        *("mm", "µm", "nm"),
        *("mm", "mm"),
    ]
