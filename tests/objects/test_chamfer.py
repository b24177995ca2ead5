"""Chamfers break the edges of a step block and leave its faces where they are."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from macro_artefacts import check_refused, check_repeatable, check_solid, fresh

from slbench import objects

BLOCK = {"heights_mm": [1.0, 2.5, 5.0], "step_length_mm": 14.0, "width_mm": 30.0}


@given(
    st.lists(st.floats(0.01, 10.0), min_size=1, max_size=6),
    st.floats(0.1, 50.0),
    st.floats(0.1, 1.0),
)
def test_any_chamfered_block_is_the_sharp_one_less_its_edges(rises, step, share):
    parameters = {
        "heights_mm": list(itertools.accumulate(rises)),
        "step_length_mm": step,
        "width_mm": 2.0 * step,
    }
    sharp = fresh("step_block", parameters)
    heights = [0.0, *parameters["heights_mm"]]
    smallest = min(b - a for a, b in itertools.pairwise(heights))
    chamfer = max(share * min(0.15 * step, smallest - 1e-3), 1e-3)
    block = fresh("step_block", {**parameters, "chamfer_mm": chamfer})
    check_solid(block.mesh)
    assert block.features == sharp.features
    assert block.certified == sharp.certified
    np.testing.assert_array_equal(block.mesh.bounds, sharp.mesh.bounds)
    # A triangular prism off every rise; the difference of two volumes keeps fewer digits.
    lost = len(rises) * 0.5 * chamfer**2 * 2.0 * step
    assert sharp.mesh.volume - block.mesh.volume == pytest.approx(
        lost, rel=1e-9, abs=1e-11 * sharp.mesh.volume
    )
    measured = objects.measure(block)
    for key, height in block.certified.items():
        assert measured[key] == pytest.approx(height, abs=1e-10)
    for plane in block.planes:
        assert measured[f"{plane.name}_flatness_um"] < 1e-7


def test_chamfers_lie_at_45_degrees_on_the_rises():
    mesh = fresh("step_block", {**BLOCK, "chamfer_mm": 0.5}).mesh
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    inclined = np.abs(normals @ [-math.sqrt(0.5), 0.0, math.sqrt(0.5)] - 1.0) < 1e-12
    # Two triangles on each of three rises; all other faces are square to an axis.
    assert np.count_nonzero(inclined) == 6
    assert np.abs(normals[~inclined]).max(axis=1) == pytest.approx(1.0, abs=1e-12)
    assert mesh.face_areas[inclined].sum() == pytest.approx(3 * 30.0 * 0.5 * math.sqrt(2))
    middles = ((a + b + c) / 3)[inclined]
    # Each line z - x through the chamfer's upper corner: height less the place of the edge.
    lines = sorted(set(np.round(middles[:, 2] - middles[:, 0], 9)))
    expected = sorted(h - x - 0.5 for h, x in [(1.0, -14.0), (2.5, 0.0), (5.0, 14.0)])
    assert lines == pytest.approx(expected)


def test_a_sharp_block_is_the_default():
    assert fresh("step_block", BLOCK).parameters["chamfer_mm"] == 0.0
    sharp, zero = fresh("step_block", BLOCK), fresh("step_block", {**BLOCK, "chamfer_mm": 0.0})
    assert sharp.mesh.vertices.tobytes() == zero.mesh.vertices.tobytes()
    check_repeatable("step_block", {**BLOCK, "chamfer_mm": 0.4})


@pytest.mark.parametrize("chamfer", [0.999, 1.0, 2.0, -0.1, 1e-5, math.nan, math.inf, "0.2", None])
def test_refused_chamfers(chamfer):
    # The smallest rise is 1 mm, and a micrometre of wall stays below the chamfer.
    allowed = 0.999 if chamfer != 0.999 else 0.9
    parameters = {**BLOCK, "chamfer_mm": allowed, "margin_fraction": 0.1}
    change = {"chamfer_mm": chamfer}
    if chamfer == 0.999:
        change["margin_fraction"] = 0.07  # 0.98 mm: now it reaches into the interior
    check_refused("step_block", parameters, change, "chamfer_mm")
