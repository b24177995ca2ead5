"""What a view is predicted to measure: closed forms, brute force, and a scan's own pixels."""

from dataclasses import replace

import manifold3d
import numpy as np
import pytest
from view_parts import above, l_block, part_scene, shipped_part

from slbench.core.errors import InputError
from slbench.design.views.predict import Predictor
from slbench.objects import Artefact, Mesh
from slbench.objects.mesh.booleans import cylinder
from slbench.rig import Pose
from slbench.simulate.scan import scan
from slbench.simulate.viewpoints.samples import sample_surface
from slbench.simulate.viewpoints.views import Counting, moved


def crossing(points, source, axis, value):
    """Return where the lines from points to a source cross a plane of an axis, (n, 3)."""
    share = (value - points[:, axis]) / (source[axis] - points[:, axis])
    return points + share[:, np.newaxis] * (source - points)


def test_the_wall_of_an_l_block_shades_its_floor_as_lines_say():
    source = np.array([-300.0, 0.0, 500.0])
    scene = above(part_scene(l_block()), tuple(source))
    samples = sample_surface(l_block().mesh, 20_000)
    seen = Predictor(scene, samples).predict(Pose()).seen
    up = samples.normals[:, 2] > 0.5
    floor = up & (samples.points[:, 2] < 0.0)
    top = up & ~floor
    # The wall's edge is at x = -10, z = 20; it is longer than the floor is wide.
    height = crossing(samples.points[floor], source, 0, -10.0)[:, 2]
    clear = np.abs(height - 20.0) > 1e-4
    assert np.array_equal(seen[floor][clear], height[clear] > 20.0)
    # The shadow ends at x = 8.125: 60.4 % of the floor.  A third of the deviation that 5,800
    # samples at random would have.
    assert seen[floor].mean() == pytest.approx(1.0 - 18.125 / 30.0, abs=0.003)
    assert seen[top].all()
    # The wall's inner side faces the camera, and not the projector; all others neither.
    assert not seen[~up].any()


def bored_block() -> Artefact:
    """Return a block of 40 x 40 x 20 mm, its top at z = 0, with a blind bore of 12 x 15 mm."""
    block = manifold3d.Manifold.cube((40.0, 40.0, 20.0), True).translate((0.0, 0.0, -10.0))
    bore = cylinder(6.0, -15.0, 1.0, 1.0)
    raw = (block - bore).to_mesh64()
    mesh = Mesh(np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts, np.int64))
    assert mesh.is_watertight
    return Artefact("bored-block", "mesh", {}, mesh, {})


@pytest.mark.parametrize("x", [60.0, 150.0, -220.0])
def test_a_bore_is_lit_and_seen_through_its_mouth(x):
    source, eye = np.array([x, 40.0, 500.0]), np.array([0.0, 0.0, 600.0])
    scene = above(part_scene(bored_block()), tuple(source))
    samples = sample_surface(scene.objects[0].artefact.mesh, 40_000)
    seen = Predictor(scene, samples).predict(Pose()).seen
    bottom = (samples.normals[:, 2] > 0.5) & (samples.points[:, 2] < -14.0)
    assert np.count_nonzero(bottom) > 500
    out = [
        np.linalg.norm(crossing(samples.points[bottom], one, 2, 0.0)[:, :2], axis=1)
        for one in (source, eye)
    ]
    # The mouth is a polygon that is off the circle by a micrometre.
    clear = np.all([np.abs(radius - 6.0) > 2e-3 for radius in out], axis=0)
    expected = np.all([radius < 6.0 for radius in out], axis=0)
    assert np.array_equal(seen[bottom][clear], expected[clear])
    assert 0.0 < expected.mean() < 1.0


def blocked(mesh, start, toward):
    """Return whether triangles stand in the way, by Möller and Trumbore in double precision."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    e1, e2 = b - a, c - a
    p = np.cross(toward, e2)
    det = np.sum(e1 * p, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / det
        t = start - a
        u = np.sum(t * p, axis=1) * inverse
        q = np.cross(t, e1)
        v = np.sum(toward * q, axis=1) * inverse
        along = np.sum(e2 * q, axis=1) * inverse
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0) & (along < 1)
    return bool(hit.any())


def test_an_engine_block_hides_what_brute_force_says():
    scene = shipped_part("engine-block")
    turn = np.array(
        [[1.0, 0.0, 0.0], [0.0, np.sqrt(0.5), -np.sqrt(0.5)], [0, np.sqrt(0.5), np.sqrt(0.5)]]
    )
    pose = Pose(turn, np.array([0.0, 0.0, 5.0]))
    mesh = scene.objects[0].artefact.mesh
    samples = sample_surface(mesh, 600)
    seen = Predictor(scene, samples, Counting(within_volume=False)).predict(pose).seen
    rig = moved(scene.rig, pose.inverse)
    expected = np.ones(len(samples), np.bool_)
    for device in (rig.camera, rig.projector):
        eye = device.pose.position
        expected &= device.contains(device.project(samples.points))
        expected &= np.sum((eye - samples.points) * samples.normals, axis=1) > 0
        for k in np.flatnonzero(expected):
            start = samples.points[k] + 1e-3 * samples.normals[k]
            expected[k] = not blocked(mesh, start, eye - start)
    assert 100 < expected.sum() < 500
    assert np.count_nonzero(seen != expected) <= 1  # at an edge within a micrometre


def at_samples(result, pose, samples):
    """Return the deviation at each sample's pixel and whether the surface is smooth there."""
    pixel = result.scene.rig.camera.project(pose.to_world(samples.points))
    u, v = np.clip(np.rint(pixel).astype(int), 0, np.array(result.transport.shape)[::-1] - 1).T
    return result.cloud.image(result.cloud.sigma_total_mm)[v, u], result.truth.smooth()[v, u]


@pytest.mark.parametrize("patterns", ["1,10,50", "gray+16@8"])
def test_the_deviation_is_that_of_a_scan(patterns):
    scene = part_scene(l_block(), divisor=2).with_patterns(patterns)
    turn = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    pose = Pose(turn, np.zeros(3))
    posed = scene.objects[0]
    scene = replace(scene, objects=(replace(posed, pose=pose),))
    samples = sample_surface(posed.artefact.mesh, 4000)
    found = Predictor(scene, samples, Counting(within_volume=False)).predict(pose)
    result = scan(scene, score=False)
    measured, smooth = at_samples(result, pose, samples)
    both = smooth & found.measured() & np.isfinite(measured)
    assert np.count_nonzero(both) > 300
    # A pixel's own deviation is estimated from its frames and scatters by a tenth; its median is
    # predicted within the shape of the blur, 2 %, and the light of the walls' other side.
    assert np.median(found.sigma_mm[both] / measured[both]) == pytest.approx(1.0, abs=0.05)
    assert np.mean(np.isfinite(measured[smooth & found.measured()])) > 0.99
    assert np.mean(found.measured()[smooth & found.seen & np.isfinite(measured)]) > 0.98


def test_points_outside_the_volume_do_not_count():
    scene = part_scene(l_block())
    samples = sample_surface(l_block().mesh, 2000)
    pose = Pose(np.eye(3), np.array([0.0, 0.0, -8.0]))  # the floor at z = -18, of 15
    inside = Predictor(scene, samples).predict(pose)
    anywhere = Predictor(scene, samples, Counting(within_volume=False)).predict(pose)
    assert np.array_equal(inside.seen, anywhere.seen)
    z = pose.to_world(samples.points)[:, 2]
    half = 0.5 * scene.rig.volume_mm[2]
    assert np.array_equal(inside.measured(), anywhere.measured() & (np.abs(z) <= half))
    assert inside.measured().sum() < anywhere.measured().sum()


def test_a_limit_takes_the_worst_away():
    scene = part_scene(l_block())
    samples = sample_surface(l_block().mesh, 2000)
    found = Predictor(scene, samples).predict(Pose())
    limit = float(np.nanmedian(found.sigma_mm))
    assert found.measured(limit).sum() == pytest.approx(0.5 * found.measured().sum(), abs=1)


@pytest.mark.parametrize("patterns", ["de-bruijn8px", "white+black+1,16@3+rgb"])
def test_patterns_that_cannot_be_predicted_are_refused(patterns):
    scene = part_scene(l_block()).with_patterns(patterns)
    samples = sample_surface(l_block().mesh, 100)
    with pytest.raises(InputError, match="to plan views"):
        Predictor(scene, samples)
