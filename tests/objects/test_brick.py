"""Bricks are exact: pins of equal size at their places on a flat body."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from macro_artefacts import (
    check_refused,
    check_repeatable,
    check_shipped,
    check_solid,
    fresh,
    solid,
)

from slbench import objects


@settings(max_examples=10)
@given(
    columns=st.integers(1, 6),
    rows=st.integers(2, 6),
    pitch=st.floats(0.5, 50.0),
    share=st.floats(0.1, 0.75),
    height=st.floats(0.01, 20.0),
    body=st.floats(0.1, 50.0),
    clearance=st.floats(0.0, 0.04),
)
def test_any_brick_is_an_exact_solid(columns, rows, pitch, share, height, body, clearance):
    brick = fresh(
        "brick",
        {
            "columns": columns,
            "rows": rows,
            "pitch_mm": pitch,
            "pin_diameter_mm": share * pitch,
            "pin_height_mm": height,
            "body_height_mm": body,
            "clearance_mm": clearance * pitch,
            "max_form_error_um": 0.2 * pitch,
        },
    )
    check_solid(brick.mesh)
    size = pitch * (np.array([columns, rows]) - 2 * clearance)
    bounds = [[-size[0] / 2, -size[1] / 2, -body], [size[0] / 2, size[1] / 2, height]]
    np.testing.assert_allclose(brick.mesh.bounds, bounds, rtol=1e-12)
    # Polygons of the circle's area: the volume of true cylinders, but for rounding.
    pins = columns * rows * math.pi / 4 * (share * pitch) ** 2 * height
    assert brick.mesh.volume == pytest.approx(size.prod() * body + pins, rel=1e-10)
    measured = objects.measure(brick)
    assert set(brick.certified) <= set(measured)
    for key, value in brick.certified.items():
        assert measured[key] == pytest.approx(value, rel=1e-11, abs=1e-9), key
    assert len(brick.steps) == columns * rows


def test_pins_measured_by_another_kernel():
    brick = fresh("brick", {"columns": 4, "rows": 3})
    loops = [np.asarray(loop) for loop in solid(brick.mesh).slice(0.9).to_polygons()]
    assert len(loops) == 12
    centres = []
    for loop in loops:
        x, y = loop.T
        cross = x * np.roll(y, -1) - np.roll(x, -1) * y
        # Cross-sections are kept on a grid of about 1e-8.
        assert cross.sum() / 2 == pytest.approx(math.pi * 2.4**2, abs=1e-6)
        centres.append([((c + np.roll(c, -1)) * cross).sum() / (3 * cross.sum()) for c in (x, y)])
        radius = np.linalg.norm(loop - centres[-1], axis=1)
        middle = np.linalg.norm((loop + np.roll(loop, 1, axis=0)) / 2 - centres[-1], axis=1)
        assert radius.max() - 2.4 < 0.5e-3
        assert 2.4 - middle.min() < 0.5e-3
    expected = [(8.0 * i - 12.0, 8.0 * j - 8.0) for i in range(4) for j in range(3)]
    np.testing.assert_allclose(sorted(np.round(centres, 7).tolist()), expected, atol=1e-6)


@pytest.mark.parametrize(("columns", "rows"), [(1, 2), (4, 6), (3, 5)])
def test_interiors_lie_on_their_own_face(columns, rows):
    brick = fresh("brick", {"columns": columns, "rows": rows})
    rng = np.random.default_rng(2)
    for face in brick.planes:
        places = rng.uniform(*np.transpose([face.x_mm, face.y_mm]), (20, 2))
        assert objects.surface_height(brick.mesh, places) == pytest.approx(face.z_mm, abs=1e-12)
        # A tenth of a pin's diameter away from every wall, unless said otherwise.
        for dx, dy in ([0.47, 0], [-0.47, 0], [0, 0.47], [0, -0.47]):
            beside = objects.surface_height(brick.mesh, places + np.array([dx, dy]))
            assert beside == pytest.approx(face.z_mm, abs=1e-12)
    names = [face.name for face in brick.steps]
    assert names[0] == "pin_1_1"
    assert names[-1] == f"pin_{rows}_{columns}"
    assert brick.steps[-1].x_mm[0] > 0 or columns == 1


def test_the_shipped_brick():
    brick = check_shipped("brick")
    check_solid(brick.mesh)
    check_repeatable("brick", brick.parameters)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"pitch_mm": 4.0}, "pin_diameter_mm"),
        ({"pin_diameter_mm": 7.0}, "pin_diameter_mm"),
        ({"pin_diameter_mm": 0.001}, "max_form_error_um"),
        ({"clearance_mm": 1.7}, "pin_diameter_mm"),
        ({"margin_fraction": 0.35}, "pin_diameter_mm"),
    ],
)
def test_refused_bricks(change, key):
    check_refused("brick", {"columns": 4, "rows": 6}, change, key)
