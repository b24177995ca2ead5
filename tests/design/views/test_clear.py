"""Bodies clear of the part: boxes against triangles by linear programming, winding, the table."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog
from view_parts import above, l_block, part_scene

from slbench import objects
from slbench.design.views.candidates import Candidate
from slbench.design.views.clear import Clearance, meets_box, winding_number
from slbench.rig import Pose


def meet_by_programming(triangle, half):
    """Return whether some point of the triangle, by its weights, is in the box."""
    a = np.vstack((triangle.T, -triangle.T))
    found = linprog(np.zeros(3), a, np.tile(half, 2), np.ones((1, 3)), [1.0], bounds=(0, 1))
    return found.status == 0


def test_boxes_meet_triangles_as_linear_programming_says():
    rng = np.random.default_rng(0)
    half = np.array([1.0, 0.6, 0.3])
    triangles = 0.8 * (rng.normal(size=(400, 1, 3)) + rng.normal(size=(400, 3, 3)))
    expected = np.array([meet_by_programming(one, half) for one in triangles])
    assert 100 < expected.sum() < 300
    assert np.array_equal(meets_box(triangles, half), expected)


def test_a_point_inside_is_wound_about_once():
    mesh = objects.load_artefact("engine-block").mesh
    solid = mesh.vertices[mesh.faces]
    inside = l_block().mesh
    corners = inside.vertices[inside.faces]
    for point, number in (((-15.0, 0.0, 10.0), 1.0), ((5.0, 0.0, 10.0), 0.0), ((90, 0, 0), 0.0)):
        assert winding_number(corners - point) == pytest.approx(number, abs=1e-9)
    assert winding_number(solid - (0.0, 0.0, 500.0)) == pytest.approx(0.0, abs=1e-9)


def at(pose, stands=False, table=None):
    return Candidate(pose, -1, "", table or Pose(), stands)


@pytest.mark.parametrize(
    "body",
    [
        {"body_mm": (50.0, 50.0, 80.0)},
        {"barrel_mm": ((0.0, 25.0), (20.0, 25.0), (80.0, 10.0))},
        # A barrel takes the place of a body.
        {"body_mm": (500.0, 500.0, 500.0), "barrel_mm": ((0.0, 25.0), (80.0, 25.0))},
    ],
)
def test_a_part_at_a_body_is_refused(body):
    scene = above(part_scene(l_block()), (300.0, 0.0, 500.0))
    camera = replace(scene.rig.camera, **body)
    rig = scene.rig.having(camera=camera)
    clear = Clearance(rig, l_block().mesh, 5.0, False)
    assert clear.reason(at(Pose())) is None
    # The body begins at z = 600 and the block ends 20 mm above its middle.
    for z, met in ((570.0, False), (574.5, False), (575.5, True), (640.0, True)):
        reason = clear.reason(at(Pose(np.eye(3), np.array([0.0, 0.0, z]))))
        assert (reason == "camera meets the part") == met, z
    # All of a small body inside the part.
    small = rig.having(camera=replace(scene.rig.camera, body_mm=(2.0, 2.0, 2.0)))
    within = Pose(np.eye(3), np.array([15.0, 0.0, 601.0]))
    assert Clearance(small, l_block().mesh, 0.0, False).reason(at(within)) is not None


def test_a_device_below_the_table_is_refused():
    scene = above(part_scene(l_block()), (300.0, 0.0, 500.0))
    clear = Clearance(scene.rig, l_block().mesh, 0.0, False)
    low = Pose(np.eye(3), np.array([0.0, 0.0, 499.0]))
    high = Pose(np.eye(3), np.array([0.0, 0.0, 501.0]))
    assert clear.reason(at(Pose(), True, low)) is None
    assert clear.reason(at(Pose(), True, high)) == "projector below the table"
    body = replace(scene.rig.projector, body_mm=(100.0, 100.0, 10.0))
    robot = Clearance(scene.rig.having(projector=body), l_block().mesh, 0.0, True)
    assert robot.reason(at(Pose(), True, low)) == "projector below the table"
