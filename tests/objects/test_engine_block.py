"""Engine blocks keep a wall between all their cavities, and bores where they are certified."""

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
from slbench.core.errors import InputError

BLOCK = {
    "bank_angle_deg": 90.0,
    "bore_diameter_mm": 13.0,
    "bore_spacing_mm": 20.0,
    "stagger_mm": 3.0,
    "deck_distance_mm": 20.0,
    "deck_width_mm": 18.0,
    "valley_width_mm": 7.0,
    "crankcase_width_mm": 26.0,
    "skirt_mm": 8.0,
    "tunnel_diameter_mm": 9.0,
    "wall_mm": 2.5,
}
# Openings of the cavities: three bays below, six bores above, the tunnel through four webs.
# Joining four spaces (the bays and the outside) by 13 openings makes 13 - 3 handles.
GENUS = 10


@settings(max_examples=6)
@given(
    scale=st.floats(0.1, 10.0),
    angle=st.floats(75.0, 100.0),
    bore=st.floats(8.0, 13.0),
    stagger=st.floats(0.0, 4.0),
    tunnel=st.floats(4.0, 10.0),
)
def test_any_block_is_one_solid_with_its_openings(scale, angle, bore, stagger, tunnel):
    change = {"bore_diameter_mm": bore, "stagger_mm": stagger, "tunnel_diameter_mm": tunnel}
    lengths = {
        key: value * scale for key, value in {**BLOCK, **change}.items() if key.endswith("_mm")
    }
    # Narrow angles bring the bays' corners nearer to the decks; a few more millimetres.
    lengths["deck_distance_mm"] = 24.0 * scale
    block = fresh("engine_block", {**BLOCK, **lengths, "bank_angle_deg": angle})
    check_solid(block.mesh, GENUS)
    measured = objects.measure(block)
    assert set(block.certified) <= set(measured)
    for key, value in block.certified.items():
        assert measured[key] == pytest.approx(value, rel=1e-11, abs=1e-9), key


def test_scaled_blocks_at_their_limits_are_taken():
    """Bore and wall fill the deck, tunnel and wall the skirt, to rounding; beyond is refused."""
    limits = {"bore_diameter_mm": 13.0, "tunnel_diameter_mm": 2.0 * (BLOCK["skirt_mm"] - 2.5)}
    assert BLOCK["wall_mm"] == 2.5
    for scale in (1.0, 4.492458992176611, 0.1, 1.0 / 3.0, 7.7):
        lengths = {k: v * scale for k, v in (BLOCK | limits).items() if k.endswith("_mm")}
        lengths["tunnel_diameter_mm"] = min(lengths["tunnel_diameter_mm"], 10.0 * scale)
        lengths["deck_distance_mm"] = 24.0 * scale
        fresh("engine_block", {**BLOCK, **lengths})
        with pytest.raises(InputError, match="deck_width_mm"):
            fresh("engine_block", {**BLOCK, **lengths, "bore_diameter_mm": 13.001 * scale})


@pytest.mark.parametrize("change", [{}, {"bank_angle_deg": 60.0, "deck_distance_mm": 27.0}])
def test_bores_measured_by_another_kernel(change):
    block = fresh("engine_block", {**BLOCK, **change})
    half = block.parameters["bank_angle_deg"] / 2
    body = solid(block.mesh)
    # The crank axis from the profile's own corners: the deck's middle is this far along the
    # bank's axis, seen from it.
    top = block.mesh.bounds[1]
    sine, cosine = math.sin(math.radians(half)), math.cos(math.radians(half))
    distance = block.parameters["deck_distance_mm"]
    crank = top[2] - (distance * cosine + 9.0 * sine)
    # The decks' outer edges are the widest places.
    assert top[0] == pytest.approx(distance * sine + 9.0 * cosine, rel=1e-12)
    for side in (-1, 1):
        upright = body.translate([0, 0, -crank]).rotate([0, -side * half, 0])
        # Just under the deck, square to the bank's axis: three circles (on a grid of 1e-8).
        loops = [np.asarray(loop) for loop in upright.slice(distance - 0.01).to_polygons()]
        holes = []
        for x, y in (loop.T for loop in loops):
            cross = x * np.roll(y, -1) - np.roll(x, -1) * y
            if cross.sum() < 0:
                assert -cross.sum() / 2 == pytest.approx(math.pi * 6.5**2, abs=1e-5)
                holes.append(
                    [((c + np.roll(c, -1)) * cross).sum() / (3 * cross.sum()) for c in (x, y)]
                )
        expected = [(0.0, 20.0 * (i - 1) + side * 1.5) for i in range(3)]
        np.testing.assert_allclose(sorted(holes, key=lambda c: c[1]), expected, atol=1e-6)
        # And nothing stands above the deck.
        assert upright.bounding_box()[5] == pytest.approx(distance, rel=1e-12)


def test_half_a_turn_leaves_the_block_as_it_is():
    # Staggered banks have this symmetry and no mirror symmetry.
    mesh = fresh("engine_block", {**BLOCK, "max_form_error_um": 20.0}).mesh
    body = solid(mesh)
    turned = body.rotate([0.0, 0.0, 180.0])
    assert (body ^ turned).volume() == pytest.approx(body.volume(), rel=1e-9)
    mirrored = body.mirror([1.0, 0.0, 0.0])
    assert (body ^ mirrored).volume() < 0.99 * body.volume()
    low, high = mesh.bounds
    np.testing.assert_allclose(low[:2], -high[:2], rtol=1e-12)


def test_parts_are_what_their_names_say():
    block = fresh("engine_block", BLOCK)
    assert list(block.parts) == ["casting", "decks", "bores"]
    mesh = block.mesh
    areas = {name: mesh.face_areas[part].sum() for name, part in block.parts.items()}
    # Two rectangles less three circles each.
    assert areas["decks"] == pytest.approx(2 * (18.0 * 62.5 - 3 * math.pi * 6.5**2), rel=1e-9)
    # Every face of a bore is parallel to the axis of its bank, through (0, 0, crank).
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[block.parts["bores"]]], 1, 0)
    normals = np.cross(b - a, c - a)
    along = np.abs(normals @ (np.array([[1, -1], [0, 0], [1, 1]]) / math.sqrt(2)))
    assert along.min(axis=1).max() < 1e-9


def test_the_valley_is_the_reference():
    block = fresh("engine_block", BLOCK)
    face = block.reference
    assert face.x_mm == pytest.approx((-3.5 + 0.15 * 7, 3.5 - 0.15 * 7))
    places = np.random.default_rng(5).uniform(*np.transpose([face.x_mm, face.y_mm]), (200, 2))
    assert (objects.surface_height(block.mesh, places) == 0.0).all()
    # It ends where it says: the banks rise beyond.
    edge = np.column_stack([[-3.6, 3.6], [0.0, 0.0]])
    assert (objects.surface_height(block.mesh, edge) > 0.05).all()


def test_the_shipped_block():
    block = check_shipped("engine-block")
    check_solid(block.mesh, GENUS)
    check_repeatable("engine_block", block.parameters)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"bore_diameter_mm": 14.0}, "deck_width_mm"),
        ({"bore_spacing_mm": 18.5}, "bore_spacing_mm"),
        ({"stagger_mm": 4.5}, "bore_spacing_mm"),
        ({"deck_distance_mm": 15.0}, "deck_distance_mm"),
        ({"deck_distance_mm": 13.0}, "valley_width_mm"),
        ({"valley_width_mm": 16.0}, "valley_width_mm"),
        ({"crankcase_width_mm": 41.1}, "crankcase_width_mm"),
        ({"crankcase_width_mm": 14.0}, "crankcase_width_mm"),
        ({"skirt_mm": 6.0}, "skirt_mm"),
        ({"tunnel_diameter_mm": 12.0}, "skirt_mm"),
    ],
)
def test_refused_blocks(change, key):
    check_refused("engine_block", BLOCK, change, key)
