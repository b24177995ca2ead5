"""Points that are looked at without pixels, against pixels' ground truth and light transport."""

import numpy as np
from scenes_small import at, scene_of, small
from stages import trace

from slbench import objects
from slbench.rig import Pose
from slbench.scene.truth import Status
from slbench.simulate.render.groundtruth import ground_truth
from slbench.simulate.render.lookout import Lookout


def test_radiance_is_that_of_the_traced_white_picture():
    scene = small("step-block", samples=64)
    truth = ground_truth(scene.objects, scene.rig)
    smooth = truth.smooth()
    lookout = Lookout(scene.objects, truth.point[smooth], truth.normal[smooth])
    fall_off = scene.rig.camera.relative_illumination(scene.rig.camera.pixel_grid())[smooth]
    white, _ = next(iter(trace(scene).whites()))
    ratio = lookout.radiance(scene.rig) * fall_off / white[smooth]
    # 64 samples over a pixel and both lenses against their middles.
    assert abs(np.median(ratio) - 1.0) < 5e-4
    assert np.percentile(np.abs(ratio - 1.0), 99) < 3e-3


def test_free_ways_are_those_of_the_ground_truth():
    scene = small("step-block")
    truth = ground_truth(scene.objects, scene.rig)
    hit = truth.object_id >= 0
    lookout = Lookout(scene.objects, truth.point[hit], truth.normal[hit])
    everything = np.ones(np.count_nonzero(hit), np.bool_)
    lit = lookout.seen_by(scene.rig.projector, everything)
    status = truth.status[hit]
    assert np.array_equal(lit, (status == Status.LIT) | (status == Status.OUTSIDE))
    # Pixels were shot from the camera, so it sees all but what rounding takes at edges.
    assert lookout.seen_by(scene.rig.camera, everything).mean() > 0.999
    half = everything.copy()
    half[::2] = False
    assert np.array_equal(lookout.seen_by(scene.rig.projector, half), lit & half)


def test_albedo_is_that_of_the_material():
    scene = scene_of([at(objects.load_artefact("sphere"), albedo=0.37)])
    mesh = scene.objects[0].artefact.mesh
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[::50]], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lookout = Lookout(scene.objects, (a + b + c) / 3.0, normals)
    assert np.allclose(lookout.albedo(), 0.37, atol=1e-5)


def test_a_point_is_dark_where_it_faces_away():
    scene = scene_of([at(objects.load_artefact("plane"))])
    points, up = np.zeros((2, 3)), np.array([[0.0, 0.0, 1.0]] * 2)
    lookout = Lookout(scene.objects, points, up)
    assert np.all(lookout.radiance(scene.rig) > 0.0)
    projector = scene.rig.projector
    below = Pose(projector.pose.rotation @ np.diag([1.0, -1.0, -1.0]), -projector.pose.position)
    rig = scene.rig.having(projector=projector.posed(below))
    assert not lookout.seen_by(rig.projector, np.ones(2, np.bool_)).any()
