"""Ground truth against rays met with planes and spheres on paper."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers_scene import scene
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from stages import ground_truth, trace

from slbench import objects
from slbench.core.errors import InputError
from slbench.core.io import read_exr, write_exr
from slbench.objects import Artefact, Mesh
from slbench.patterns import PatternSequence
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.rig.opencv import write_rig
from slbench.rig.optics.distortion import fold_radius
from slbench.scene.model import Scene, SceneObject
from slbench.scene.truth import GroundTruth, Status

DISTORTION = (-0.2, 0.08, 0.002, -0.003, 0.02)
RATIONAL = (0.4, -0.3, 0.002, -0.003, 0.2, 0.7, -0.2, 0.3, 0.004, -0.01, -0.003, 0.02)
TILT = (0.05, -0.03)
SIZE = (80, 60)
PANEL = (160, 120)
BALL = objects.build_artefact("sphere", {"radius_mm": 12.5, "max_form_error_um": 50.0})


def make_rig(camera=None, projector=None, distortion=None):
    """Return a rig with fields of some 130 mm (camera) and 190 mm (projector) at the origin."""
    more = {"distortion": distortion, "tilt_rad": TILT} if distortion else {}
    return Rig(
        Camera(
            *SIZE,
            (0.06, 0.06),
            camera or Lens(16.0, 2.0, 440.0),
            pose=Pose.looking_at((-220.0, 40.0, 380.0), (0, 0, 0), (0.1, -1, 0)),
            **more,
        ),
        Projector(
            *PANEL,
            (0.04, 0.04),
            projector or Lens(28.0, 5.0, 780.0),
            pose=Pose.looking_at((300.0, 100.0, 720.0), (0, 0, 0), (0, -1, 0)),
            **more,
        ),
    )


RIGS = {
    "thin lenses": make_rig(),
    "distorted and tilted": make_rig(distortion=DISTORTION),
    "rational with a thin prism": make_rig(distortion=RATIONAL),
    "telecentric": make_rig(
        Lens.telecentric(0.04, 0.01, 440.0), Lens.telecentric(0.04, 0.005, 780.0)
    ),
}


def scene_of(rig, *items):
    return Scene("truth", rig, items, PatternSequence.parse("1", PANEL))


def plate(size=(400.0, 400.0), pose=None):
    artefact = objects.build_artefact("plane", {"size_mm": size, "thickness_mm": 1.0})
    return SceneObject(artefact, pose or Pose())


def solid(mesh_vertices, mesh_faces, pose=None):
    return SceneObject(
        Artefact("solid", "mesh", {}, Mesh(mesh_vertices, mesh_faces), {}), pose or Pose()
    )


def box(low, high):
    """Return a box and its eight corners."""
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    hull = ConvexHull(corners)
    faces = hull.simplices.copy()
    normals = np.cross(
        corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]]
    )
    inward = np.sum(normals * hull.equations[:, :3], axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return solid(corners, faces), corners


def check_devices(truth, rig):
    """Pixel, depth, panel coordinate and blur of the truth's points, by OpenCV and by hand."""
    hit = truth.status != Status.MISSED
    point = truth.point[hit]
    camera, projector = rig.camera, rig.projector
    z_camera = (point - camera.pose.position) @ camera.pose.rotation[:, 2]
    z_projector = (point - projector.pose.position) @ projector.pose.rotation[:, 2]
    np.testing.assert_allclose(truth.depth[hit], z_camera, rtol=0, atol=1e-9)
    np.testing.assert_allclose(truth.panel[hit], projector.project(point), rtol=0, atol=1e-9)
    if camera.lens.kind == "perspective":
        for device, expected in (
            (camera, camera.pixel_grid()[hit]),
            (projector, truth.panel[hit]),
        ):
            rotation = device.pose.rotation.T
            pixels, _ = cv2.projectPoints(
                point,
                cv2.Rodrigues(rotation)[0],
                -rotation @ device.pose.position,
                device.matrix,
                device.opencv_distortion,
            )
            # A rotation vector keeps a rotation to 1e-15, some 1e-12 px.
            np.testing.assert_allclose(pixels[:, 0], expected, rtol=0, atol=1e-8)
    if not any(camera.tilt_rad):
        for device, z, coc in (
            (camera, z_camera, truth.camera_coc),
            (projector, z_projector, truth.projector_coc),
        ):
            lens = device.lens
            scale = lens.focus_distance_mm if lens.kind == "telecentric" else z
            # Thin lens: 2 a c |1/s - 1/Z|; telecentric: the cone's width at Z, magnified.
            blur = 2 * lens.aperture_radius_mm * lens.focal_length_mm / device.pitch_mm[0]
            blur = blur * np.abs(z - lens.focus_distance_mm) / (lens.focus_distance_mm * scale)
            np.testing.assert_allclose(coc[hit], blur, rtol=1e-9, atol=1e-9)


# -- planes and spheres ------------------------------------------------------------------------


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("angles", [(0, 0, 0), (20, -25, 40)])
def test_plane(name, angles):
    rig = RIGS[name]
    pose = Pose(
        Rotation.from_euler("XYZ", angles, degrees=True).as_matrix(), np.array([3.0, -2.0, 5.0])
    )
    truth = ground_truth(scene_of(rig, plate(pose=pose)))
    origins, directions = rig.camera.unproject(rig.camera.pixel_grid())
    normal = pose.rotation[:, 2]
    distance = ((pose.position - origins) @ normal) / (directions @ normal)
    expected = origins + distance[..., None] * directions
    assert (truth.status != Status.MISSED).all()
    # Double precision at 500 mm; distortion undone to 1e-12 by either.
    np.testing.assert_allclose(truth.point, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(truth.normal, np.broadcast_to(normal, expected.shape), atol=1e-12)
    assert (truth.object_id == 0).all()
    check_devices(truth, rig)


@pytest.mark.parametrize("name", RIGS)
def test_sphere(name):
    rig = RIGS[name]
    radius, form_um, centre = 30.0, 20.0, np.array([2.0, -3.0, 4.0])
    ball = objects.build_artefact("sphere", {"radius_mm": radius, "max_form_error_um": form_um})
    truth = ground_truth(scene_of(rig, SceneObject(ball, Pose(np.eye(3), centre))))
    origins, directions = rig.camera.unproject(rig.camera.pixel_grid())
    along = np.sum((centre - origins) * directions, axis=-1)
    nearest = np.linalg.norm(origins + along[..., None] * directions - centre, axis=-1)
    hit = truth.status != Status.MISSED
    # The silhouette is that of the sphere, within the form error.
    assert hit[nearest < radius - form_um * 1e-3].all()
    assert not hit[nearest > radius + form_um * 1e-3].any()
    # Every point lies on the sphere within the form error ...
    distance = np.linalg.norm(truth.point[hit] - centre, axis=-1)
    assert np.abs(distance - radius).max() <= form_um * 1e-3 * (1 + 1e-9)
    # ... and on its own ray.
    off = truth.point[hit] - origins[hit]
    assert np.linalg.norm(np.cross(off, directions[hit]), axis=-1).max() < 1e-9
    # Away from the rim the distance along the ray is the sphere's: form error over cosine.
    inner = hit & (nearest < 0.8 * radius)
    analytic = along - np.sqrt(np.maximum(radius**2 - nearest**2, 0.0))
    measured = np.sum((truth.point - origins) * directions, axis=-1)
    assert np.abs(measured - analytic)[inner].max() < form_um * 1e-3 / 0.6
    # Facets are chords: their normals are off by half their angular size, 2 sqrt(2 f / R) at
    # the most for a sag of f.
    radial = (truth.point - centre) / radius
    cosine = np.sum(truth.normal * radial, axis=-1)[hit]
    assert np.rad2deg(np.arccos(cosine.min())) < np.rad2deg(
        2 * np.sqrt(2 * form_um * 1e-3 / radius)
    )
    check_devices(truth, rig)


def test_normals_face_the_camera_whatever_the_winding():
    rig = RIGS["thin lenses"]
    # A single triangle, wound either way.
    vertices = np.array([[-200.0, -200.0, 0.0], [200.0, -200.0, 0.0], [0.0, 300.0, 0.0]])
    truths = [
        ground_truth(scene_of(rig, solid(vertices, np.array([face]))))
        for face in ([0, 1, 2], [0, 2, 1])
    ]
    for truth in truths:
        hit = truth.status != Status.MISSED
        assert hit.sum() > 1000
        np.testing.assert_allclose(truth.normal[hit], np.tile([0, 0, 1.0], (hit.sum(), 1)))
    np.testing.assert_array_equal(truths[0].status, truths[1].status)


# -- lit, shadowed, outside, missed --------------------------------------------------------------


def test_rays_past_the_object_miss():
    rig = RIGS["thin lenses"]
    half = np.array([20.0, 15.0])
    truth = ground_truth(scene_of(rig, plate(tuple(2 * half))))
    origins, directions = rig.camera.unproject(rig.camera.pixel_grid())
    place = origins - (origins[..., 2:] / directions[..., 2:]) * directions
    inside = np.all(np.abs(place[..., :2]) < half, axis=-1)
    missed = truth.status == Status.MISSED
    # The plate is a slab: some rays miss its top and meet a side.
    assert not missed[inside].any()
    far = np.any(np.abs(place[..., :2]) > half + 2.0, axis=-1)
    assert missed[far].all()
    for values in (truth.point, truth.normal, truth.depth, truth.panel):
        assert np.isnan(values[missed]).all()
    assert np.isnan(truth.camera_coc[missed]).all()
    assert np.isnan(truth.projector_coc[missed]).all()
    assert (truth.object_id[missed] == -1).all()


def in_convex(polygon, points, margin):
    """Tell which points lie inside a convex hull by more than `margin` (negative: around it)."""
    equations = ConvexHull(polygon).equations
    return np.all(points @ equations[:, :2].T + equations[:, 2] < -margin, axis=-1)


@pytest.mark.parametrize("name", ["thin lenses", "telecentric"])
def test_the_shadow_of_a_box_is_where_projection_puts_it(name):
    rig = RIGS[name]
    block, corners = box((-10.0, -8.0, 0.0), (12.0, 9.0, 45.0))
    truth = ground_truth(scene_of(rig, plate(), block))
    # The corners, seen from the projector, on the floor.
    if rig.projector.lens.kind == "telecentric":
        beam = np.broadcast_to(rig.projector.pose.rotation[:, 2], corners.shape)
    else:
        beam = corners - rig.projector.pose.position
    feet = corners - (corners[:, 2:] / beam[:, 2:]) * beam
    floor = truth.object_id == 0
    place = truth.point[..., :2]
    # Single-precision shadow rays are good to 0.1 um; a pixel is 2 mm.
    umbra = floor & in_convex(feet[:, :2], np.nan_to_num(place), 1e-3)
    clear = floor & ~in_convex(feet[:, :2], np.nan_to_num(place), -1e-3)
    assert umbra.sum() > 100
    assert (truth.status[umbra] == Status.SHADOWED).all()
    seen = truth.status[clear]
    assert np.isin(seen, (Status.LIT, Status.OUTSIDE)).all()
    # A shadowed point still says where the projector would see it.
    np.testing.assert_allclose(
        truth.panel[umbra], rig.projector.project(truth.point[umbra]), rtol=0, atol=1e-9
    )


def test_a_face_turned_away_from_the_projector_is_shadowed():
    # The camera sees the box's -x side, the projector the opposite one.
    rig = RIGS["thin lenses"]
    block, _ = box((-10.0, -8.0, 0.0), (12.0, 9.0, 45.0))
    truth = ground_truth(scene_of(rig, block))
    side = np.abs(truth.normal[..., 0] + 1.0) < 1e-9
    top = np.abs(truth.normal[..., 2] - 1.0) < 1e-9
    assert side.sum() > 50
    assert (truth.status[side] == Status.SHADOWED).all()
    assert (truth.status[top] == Status.LIT).all()


@pytest.mark.parametrize("name", RIGS)
def test_beyond_the_panel_is_outside(name):
    rig = RIGS[name]
    # Only half of the panel is left: its edge runs through the picture.
    projector = Projector(
        PANEL[0] // 2,
        PANEL[1],
        rig.projector.pitch_mm,
        rig.projector.lens,
        principal_point=rig.projector.centre,
        distortion=rig.projector.distortion,
        tilt_rad=rig.projector.tilt_rad,
        pose=rig.projector.pose,
    )
    rig = Rig(rig.camera, projector)
    sequence = PatternSequence.parse("1", (PANEL[0] // 2, PANEL[1]))
    truth = ground_truth(Scene("half", rig, (plate(),), sequence))
    u, v = truth.panel[..., 0], truth.panel[..., 1]
    inside = (u >= -0.5) & (u < PANEL[0] // 2 - 0.5) & (v >= -0.5) & (v < PANEL[1] - 0.5)
    assert 500 < inside.sum() < inside.size - 500
    assert np.array_equal(truth.status == Status.LIT, inside)
    assert (truth.status[~inside] == Status.OUTSIDE).all()


def test_the_nearest_object_is_met_and_named():
    rig = RIGS["thin lenses"]
    low = plate(pose=Pose(np.eye(3), np.array([0.0, 0.0, -10.0])))
    high = plate((40.0, 400.0), pose=Pose(np.eye(3), np.array([0.0, 0.0, 10.0])))
    for items in ((low, high), (high, low)):
        truth = ground_truth(scene_of(rig, *items))
        upper = items.index(high)
        top = truth.point[..., 2] > 9.9999
        assert 500 < top.sum() < top.size - 500
        assert (truth.object_id[top] == upper).all()
        floor = np.abs(truth.point[..., 2] + 10.0) < 1e-9
        assert (truth.object_id[floor] == 1 - upper).all()


def test_passes_do_not_show(monkeypatch):
    rig = RIGS["distorted and tilted"]
    block, _ = box((-10.0, -8.0, 0.0), (12.0, 9.0, 45.0))
    scene = scene_of(rig, plate(), block)
    whole = ground_truth(scene)
    monkeypatch.setattr("slbench.simulate.render.groundtruth._PIXELS_PER_PASS", 7 * SIZE[0])
    banded = ground_truth(scene)
    for name in ("point", "normal", "depth", "panel", "status", "object_id", "camera_coc"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(banded, name))


def test_pixels_beyond_an_invertible_distortion_miss():
    # r (1 - 0.9 r^2) never exceeds 0.41: the corners of this wide sensor see nothing.
    rig = make_rig()
    wide = Camera(
        *SIZE,
        (0.25, 0.25),
        Lens(16.0),
        distortion=(-0.9, 0.0, 0.0, 0.0, 0.0),
        pose=rig.camera.pose,
    )
    truth = ground_truth(scene_of(Rig(wide, rig.projector), plate((3000.0, 3000.0))))
    r = np.linalg.norm(wide.pixel_grid() - wide.centre, axis=-1) * 0.25 / 16.0
    turning = 1 / np.sqrt(3 * 0.9)
    limit = turning * (1 - 0.9 * turning**2)
    assert (truth.status[r > limit + 1e-3] == Status.MISSED).all()
    assert (truth.status[r < 0.9 * limit] != Status.MISSED).all()


# -- smooth pixels and the file --------------------------------------------------------------------


def test_smooth_pixels_keep_a_pixel_away_from_every_edge():
    rig = RIGS["thin lenses"]
    block, _ = box((-10.0, -8.0, 0.0), (12.0, 9.0, 45.0))
    truth = ground_truth(scene_of(rig, plate(), block))
    smooth = truth.smooth()
    assert smooth.sum() > 1000
    for v, u in np.argwhere(smooth):
        near = np.s_[v - 1 : v + 2, u - 1 : u + 2]
        assert truth.lit[near].all()
        assert len(np.unique(truth.object_id[near])) == 1
        assert len(np.unique(np.round(truth.normal[near].reshape(-1, 3), 6), axis=0)) == 1
    # A plane's panel coordinate is smooth: only borders and edges are left out.
    flat = ground_truth(scene_of(rig, plate()))
    expected = np.zeros_like(smooth)
    lit = flat.lit
    expected[1:-1, 1:-1] = np.logical_and.reduce(
        [lit[dv : dv + SIZE[1] - 2, du : du + SIZE[0] - 2] for dv in range(3) for du in range(3)]
    )
    assert np.array_equal(flat.smooth(), expected)


def test_exr_keeps_the_truth_to_single_precision(tmp_path):
    rig = RIGS["distorted and tilted"]
    truth = ground_truth(scene_of(rig, plate((60.0, 50.0)), SceneObject(BALL)))
    assert set(np.unique(truth.status)) >= {Status.MISSED, Status.LIT, Status.SHADOWED}
    truth.save(tmp_path / "truth.exr")
    again = GroundTruth.load(tmp_path / "truth.exr")
    np.testing.assert_array_equal(again.status, truth.status)
    np.testing.assert_array_equal(again.object_id, truth.object_id)
    for name in ("point", "normal", "depth", "panel", "camera_coc", "projector_coc"):
        # Single precision, NaN included.
        np.testing.assert_array_equal(
            getattr(again, name), getattr(truth, name).astype(np.float32).astype(np.float64)
        )
    channels = read_exr(tmp_path / "truth.exr")
    assert {"point.X", "normal.Z", "panel.u", "depth.Z", "status", "object"} <= set(channels)


MAPS = ("point", "normal", "depth", "panel", "camera_coc", "projector_coc")


@pytest.mark.parametrize("name", RIGS)
def test_exr_without_what_follows_from_the_rig(name, tmp_path):
    rig = RIGS[name]
    truth = ground_truth(scene_of(rig, plate((60.0, 50.0)), SceneObject(BALL)))
    truth.save(tmp_path / "all.exr")
    truth.save(tmp_path / "truth.exr", rig)
    assert set(read_exr(tmp_path / "truth.exr")) == {
        *("point.Z", "normal.X", "normal.Y", "normal.Z", "status", "object")
    }
    size = (tmp_path / "truth.exr").stat().st_size
    assert size < 0.4 * (tmp_path / "all.exr").stat().st_size
    write_rig(tmp_path / "rig.yaml", rig)
    given, beside = (GroundTruth.load(tmp_path / "truth.exr", *more) for more in ((rig,), ()))
    whole = GroundTruth.load(tmp_path / "all.exr", rig)
    for again in (given, beside):
        np.testing.assert_array_equal(again.status, whole.status)
        np.testing.assert_array_equal(again.object_id, whole.object_id)
        np.testing.assert_array_equal(again.normal, whole.normal)
        np.testing.assert_array_equal(again.point[..., 2], whole.point[..., 2])
        # Heights below 16 mm are off by 5e-7 mm; rays lean by 45 degrees at most, so that the
        # others are no further off, and no angle of a device turns 1e-6 mm into 1e-5 px.
        np.testing.assert_allclose(again.point, truth.point, rtol=0, atol=1e-6)
        np.testing.assert_allclose(again.depth, truth.depth, rtol=0, atol=1e-6)
        np.testing.assert_allclose(again.panel, truth.panel, rtol=0, atol=1e-5)
        for coc in ("camera_coc", "projector_coc"):
            np.testing.assert_allclose(getattr(again, coc), getattr(truth, coc), atol=1e-6)
    for one in MAPS:
        lost = np.isnan(getattr(given, one)) != np.isnan(getattr(truth, one))
        assert not lost.any()


def test_exr_of_rays_along_the_plane_keeps_all(tmp_path):
    """A ray at right angles to the axis of the stored coordinate is not met by it."""
    rig = RIGS["thin lenses"]
    truth = ground_truth(scene_of(rig, plate()))
    aside = Pose.looking_at((0.0, 40.0, 380.0), (380.0, 40.0, 20.0), (0, -1, 0))
    wide = replace(rig.camera, pose=aside, pitch_mm=(0.6, 0.6))
    origins, directions = wide.unproject(wide.pixel_grid())
    assert np.abs(directions).max(axis=(0, 1)).min() < 1.0
    points = origins + 300.0 * directions
    moved = replace(truth, point=points, object_id=np.zeros_like(truth.object_id))
    moved.save(tmp_path / "truth.exr", rig.having(camera=wide))
    assert {"point.X", "point.Y", "point.Z", "depth.Z"} <= set(read_exr(tmp_path / "truth.exr"))


def test_exr_of_another_camera_is_refused(tmp_path):
    rig = RIGS["thin lenses"]
    path = tmp_path / "truth.exr"
    ground_truth(scene_of(rig, plate())).save(path, rig)
    other = rig.having(camera=replace(rig.camera, width=81))
    with pytest.raises(InputError, match=r"truth\.exr: expected 81 x 60 px, got 80 x 60"):
        GroundTruth.load(path, other)
    with pytest.raises(InputError, match=r"rig\.yaml: expected"):
        GroundTruth.load(path)
    write_rig(tmp_path / "rig.yaml", other)
    with pytest.raises(InputError, match="expected the camera's 81 x 60 px, got 80 x 60"):
        GroundTruth.load(path)


def test_an_exr_without_a_channel_is_refused(tmp_path):
    path = tmp_path / "truth.exr"
    write_exr(path, {"depth.Z": np.zeros((4, 5), np.float32)})
    with pytest.raises(InputError, match=r"point\.X: expected this channel"):
        GroundTruth.load(path)


@pytest.mark.parametrize("kind", ["perspective", "telecentric"])
def test_light_and_truth_end_at_the_fold(kind):
    """No ghosts: the projector lights nothing beyond its fold, in frames and in truth."""
    lens = Lens(1.0, 0.0, 300.0)
    if kind == "telecentric":
        lens = Lens.telecentric(1.0 / 300.0, 0.0, 300.0)
    down = np.diag([1.0, -1.0, -1.0])
    folding = Projector(
        80, 60, (0.02, 0.02), lens, distortion=(-1.0, 0.0, 0.0, 0.0, 0.0),
        pose=Pose(down, np.array([0.0, 0.0, 300.0])),
    )  # fmt: skip
    wide = Camera(
        60, 60, (0.04, 0.04), Lens(1.0, 0.0, 300.0), pose=Pose(down, np.array([5.0, 0.0, 300.0]))
    )
    view = scene(Rig(wide, folding), plate((900.0, 900.0)))
    truth, transport = ground_truth(view), trace(view)
    radius = np.linalg.norm(truth.point[..., :2], axis=-1) / 300.0
    fold = fold_radius(folding.distortion)
    assert radius.max() > 2.0 * fold
    assert np.any(truth.lit)
    assert np.all(radius[truth.lit] < fold)
    light = transport.white() > 0
    # A pixel is 12 mm wide there, 0.04 of the distance.
    assert not np.any(light[radius > fold + 0.04])
    assert np.all(light[truth.lit & (radius < fold - 0.04)])


def test_nothing_comes_round_a_pole():
    """Beyond the pole of a rational lens the formula's pixels are on the panel again."""
    down = np.diag([1.0, -1.0, -1.0])
    pose = Pose(down, np.array([0.0, 0.0, 300.0]))
    folding = Projector(
        *(80, 60, (0.02, 0.02), Lens(1.0, 0.0, 300.0)),
        distortion=(0.0,) * 5 + (-1.0, 0.0, 0.0),
        pose=pose,
    )
    wide = Camera(60, 60, (0.08, 0.08), Lens(1.0, 0.0, 300.0), pose=pose)
    view = scene(Rig(wide, folding), plate((1500.0, 1500.0)))
    truth, light = ground_truth(view), trace(view).white()
    radius = np.linalg.norm(truth.point[..., :2], axis=-1) / 300.0
    ghost = radius / (radius**2 - 1.0)
    assert np.any((radius > 1.0) & (ghost < 0.5))
    assert not truth.lit[radius >= 1.0].any()
    assert not light[radius >= 1.0].any()
    assert light[radius < 0.4].all()


@pytest.mark.parametrize("vignetting", [True, False])
def test_a_camera_sees_nothing_beyond_its_fold(vignetting):
    rig = make_rig()
    lens = Lens(16.0, natural_vignetting=vignetting)
    bent = Camera(*SIZE, (0.25, 0.25), lens, None, (-0.9, 0.0, 0.0, 0.0, 0.0), pose=rig.camera.pose)
    lost = np.isnan(bent.normalise(bent.pixel_grid())[..., 0])
    assert 0.1 < lost.mean() < 0.9
    view = scene(Rig(bent, rig.projector), plate((3000.0, 3000.0)))
    assert not trace(view).white()[lost].any()
