"""Other layouts of a data set, read back by independent means."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import cv2
import datasets_small as small
import h5py
import numpy as np
import pytest
import trimesh
from scenes_small import check_refused, run_cli

from slbench import datasets
from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.datasets.export.bop import box, diameter
from slbench.datasets.export.formats import export
from slbench.datasets.export.frames import depth_scale, scaled_depth
from slbench.datasets.export.raster import depth_of_mesh
from slbench.datasets.read.recipe import Recipe
from slbench.rig import Lens
from slbench.rig.opencv import read_rig
from slbench.scene.frame_errors import Drift, Trigger
from slbench.scene.truth import GroundTruth
from slbench.simulate.scan import scan

RECIPE = Recipe("1,10", seed=3)


def read(path):
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


@pytest.fixture(scope="module")
def frames_out(data, tmp_path_factory):
    target = tmp_path_factory.mktemp("frames") / "out"
    assert export(data[:3], target, "frames", RECIPE) == 3
    return target


@pytest.fixture(scope="module")
def hdf5_path(data, tmp_path_factory):
    target = tmp_path_factory.mktemp("hdf5") / "out.h5"
    export(data, target, "hdf5", RECIPE)
    return target


@pytest.fixture(scope="module")
def bop_out(data, tmp_path_factory):
    target = tmp_path_factory.mktemp("bop") / "out"
    export(data[:3], target, "bop", RECIPE)
    return target


@pytest.fixture(scope="module")
def bop_scene(bop_out):
    place = bop_out / "train" / "000000"
    files = {
        name: json.loads((place / f"scene_{name}.json").read_text())
        for name in ("camera", "gt", "gt_info", "projector")
    }
    return place, files


class TestFrames:
    def test_one_folder_a_sample(self, frames_out):
        assert sorted(p.name for p in frames_out.iterdir() if p.is_dir()) == [
            "000000",
            "000001",
            "000002",
        ]

    def test_the_folder_is_the_samples_whatever_the_index_says(self, data, tmp_path):
        # A key of a foreign index must not lead out of the folder.
        rows = ({**data.rows[0], "key": "../outside"},)
        export(replace(data, rows=rows), tmp_path / "out", "frames")
        assert (tmp_path / "out" / "000000" / "depth.png").exists()
        assert not (tmp_path / "outside").exists()

    def test_captures_are_those_of_the_recipe(self, frames_out, data):
        for item in data[:3]:
            shots = Capture.load(frames_out / item.row["key"])
            wanted = item.capture("1,10", seed=RECIPE.seed_of(item))
            np.testing.assert_array_equal(shots.frames, wanted.frames)
            assert shots.sequence == wanted.sequence
            assert shots.rig is not None

    def test_depth_with_its_scale(self, frames_out, data):
        for item in data[:3]:
            place = frames_out / item.row["key"]
            scale = json.loads((place / "sample.json").read_text())["depth_scale_mm"]
            picture = read(place / "depth.png")
            assert picture.dtype == np.uint16
            hit = np.isfinite(item.truth.depth)
            np.testing.assert_array_equal(picture > 0, hit)
            # Rounding, by half a step at most.
            error = picture[hit] * scale - item.truth.depth[hit]
            assert np.abs(error).max() <= scale / 2 + 1e-9
            np.testing.assert_array_equal(read(place / "mask.png") > 0, item.truth.lit)

    def test_exact_truth_beside_it(self, frames_out, data):
        again = GroundTruth.load(frames_out / "000001" / "truth.exr")
        # Complete, for whoever reads EXR: nothing is left out that the sample itself leaves out.
        for name in ("point", "normal", "depth", "panel", "camera_coc", "projector_coc"):
            expected = getattr(data[1].truth, name).astype(np.float32)
            np.testing.assert_array_equal(getattr(again, name).astype(np.float32), expected)
        np.testing.assert_array_equal(again.status, data[1].truth.status)

    def test_index(self, frames_out, data):
        with (frames_out / "index.csv").open() as stream:
            rows = list(csv.DictReader(stream))
        assert [int(row["sample"]) for row in rows] == [0, 1, 2]
        assert [float(row["height_mm"]) for row in rows] == [small.height(n) for n in range(3)]

    def test_stored_frames(self, data, tmp_path):
        export(data[:1], tmp_path / "x", "frames")
        shots = Capture.load(tmp_path / "x" / "000000")
        np.testing.assert_array_equal(shots.frames, data[0].frames)


@pytest.mark.parametrize("largest", [0.9, 30.0, 65.5, 655.35, 655.36, 812.0, 4000.0])
def test_the_scale_of_depth_is_the_least_that_fits(largest):
    depth = np.array([[largest, largest / 3, np.nan]])
    scale = depth_scale(depth)
    picture = scaled_depth(depth, scale)
    assert picture[0, 2] == 0
    assert abs(picture[0, 0] * scale - largest) <= scale / 2 + 1e-12
    # Less than a factor of 2.5 is given away, but for the floor of a micrometre.
    assert picture[0, 0] > 65535 / 2.5 - 1 or scale == 1e-3


class TestHdf5:
    def test_arrays(self, hdf5_path, data):
        n = len(data)
        with h5py.File(hdf5_path) as file:
            assert file["frames"].shape == (n, 6, 48, 64)
            assert file["frames"].dtype == np.uint8
            assert file["frames"].chunks == (1, 6, 48, 64)
            assert file["frames"].compression == "gzip"
            for k, item in enumerate(data):
                wanted = item.capture("1,10", seed=RECIPE.seed_of(item)).frames
                np.testing.assert_array_equal(file["frames"][k], wanted)
                np.testing.assert_array_equal(file["mask"][k], item.truth.lit)
                np.testing.assert_array_equal(
                    file["instances"][k].astype(int) - 1, item.truth.object_id
                )
                np.testing.assert_array_equal(file["depth"][k], item.truth.depth.astype(np.float32))
            assert file["sample"][:].tolist() == [item.number for item in data]
            assert file["parameters/height_mm"][:].tolist() == data.column("height_mm").tolist()
            assert file["parameters/kind"].asstr()[0] == "step_block"

    def test_units(self, hdf5_path):
        with h5py.File(hdf5_path) as file:
            assert file["depth"].attrs["units"] == "mm"
            assert file["t"].attrs["units"] == "mm"
            assert file["panel"].attrs["units"] == "px"
            assert json.loads(file.attrs["patterns"])["panel"] == [640, 480]

    def test_calibration_and_maps_agree(self, hdf5_path):
        # Depth and K of the camera put a point where R, t and K of the projector see its panel
        # coordinate: by OpenCV alone.
        with h5py.File(hdf5_path) as file:
            k = 2
            depth, mask = file["depth"][k].astype(float), file["mask"][k]
            v, u = np.nonzero(mask)
            pixels = np.stack((u, v), axis=-1).astype(float)[:, None]
            rays = cv2.undistortPoints(pixels, file["K_camera"][k], file["dist_camera"][k])[:, 0]
            points = np.column_stack((rays, np.ones(len(rays)))) * depth[mask][:, None]
            turn, _ = cv2.Rodrigues(file["R"][k])
            seen, _ = cv2.projectPoints(
                points, turn, file["t"][k], file["K_projector"][k], file["dist_projector"][k]
            )
            wanted = file["panel"][k][:, mask].T
        # Single precision of depth: 2^-24 of 500 mm is 3e-5 mm, less than 1e-4 px here.
        np.testing.assert_allclose(seen[:, 0], wanted, atol=1e-3)

    def test_samples_of_other_sizes_are_refused(self, data, tmp_path):
        def growing(item, rng):
            return "1" if item.number == 0 else "1,10"

        with pytest.raises(InputError, match="as the first sample's"):
            export(data, tmp_path / "x.h5", "hdf5", Recipe(growing))
        assert list(tmp_path.iterdir()) == []

    def test_other_patterns_of_as_many_frames_are_refused(self, data, tmp_path):
        def either(item, rng):
            return "1,8" if item.number == 0 else "1,10"

        with pytest.raises(InputError, match=r"sample 000001.*1,8.*first sample's.*1,10"):
            export(data[:2], tmp_path / "x.h5", "hdf5", Recipe(either))
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(("before", "bits"), [(8, 12), (10, 12)])
    def test_mixed_bit_depths_are_refused(self, data, tmp_path, before, bits):
        # HDF5 clips 12 bits into an array of 8; 10 and 12 fit in one array, but mean other scales.
        items = [_detected(data[0], before), _detected(data[1], bits)]
        with pytest.raises(InputError, match=rf"sample 000001.*{before} bits.*got {bits} bits"):
            export(_only(data, items), tmp_path / "x.h5", "hdf5", RECIPE)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("device", ["camera", "projector"])
    def test_telecentric_lenses_are_refused(self, data, tmp_path, device):
        item = data[0]
        lens = Lens.telecentric(0.1, 0.01, 300.0)
        changed = replace(getattr(item.rig, device), lens=lens)
        item.__dict__["rig"] = item.rig.having(**{device: changed})
        with pytest.raises(InputError, match=f"sample 000000.*perspective {device}.*telecentric"):
            export(_only(data, [item]), tmp_path / "x.h5", "hdf5", RECIPE)
        assert list(tmp_path.iterdir()) == []


def _only(data, items):
    """Return a data set of the given samples, whatever was changed in them."""

    class Only(datasets.Dataset):
        def __iter__(self):
            return iter(items)

        def __getitem__(self, key):
            return self if isinstance(key, slice) else items[key]

    return Only(data.manifest, data.storage, data.rows[: len(items)])


def _detected(item, bits):
    """Return a sample whose scene has a detector of `bits`."""
    settings = item._settings
    detector = replace(settings.detector, bit_depth=bits)
    item.__dict__["_settings"] = replace(settings, detector=detector)
    return item


def nearest(origin, directions, triangles):
    """Return the distance along each ray (n, 3) to the nearest triangle (m, 3, 3), or inf.

    Moller and Trumbore, "Fast, minimum storage ray/triangle intersection" (1997), for all pairs.
    """
    a = triangles[:, 0]
    first, second = triangles[:, 1] - a, triangles[:, 2] - a
    best = np.full(len(directions), np.inf)
    for k, ray in enumerate(directions):
        p = np.cross(ray, second)
        det = np.einsum("ij,ij->i", first, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = origin - a
            u = np.einsum("ij,ij->i", s, p) / det
            q = np.cross(s, first)
            v = q @ ray / det
            t = np.einsum("ij,ij->i", second, q) / det
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        if hit.any():
            best[k] = t[hit].min()
    return best


def check_projection(folder, place, files, image, covered=True):
    """Cast rays onto the models as they are placed; `covered` is what the sensor sees."""
    camera = files["camera"][image]
    matrix = np.reshape(camera["cam_K"], (3, 3))
    depth = read(place / f"depth/{int(image):06d}.png") * camera["depth_scale"]
    v, u = np.indices(depth.shape)
    rays = np.stack((u, v, np.ones_like(u)), axis=-1).reshape(-1, 3)
    rays = rays @ np.linalg.inv(matrix).T
    alone = []
    for pose in files["gt"][image]:
        model = trimesh.load(folder / f"models/obj_{pose['obj_id']:06d}.ply", process=False)
        turn = np.reshape(pose["cam_R_m2c"], (3, 3))
        points = model.vertices @ turn.T + pose["cam_t_m2c"]
        # The rays' z is 1, so distance along them is depth.
        alone.append(nearest(np.zeros(3), rays, points[model.faces]))
    alone = np.reshape(alone, (-1, *depth.shape))
    visible = np.zeros(depth.shape, bool)
    for number, own in enumerate(alone):
        name = f"{int(image):06d}_{number:06d}.png"
        seen = covered & np.isfinite(own) & (own == alone.min(axis=0))
        mask, visib = read(place / "mask" / name) > 0, read(place / "mask_visib" / name) > 0
        # Models are in single precision: a pixel whose ray grazes an edge may differ.
        assert np.count_nonzero(mask != np.isfinite(own)) <= 2
        assert np.count_nonzero(visib != seen) <= 2
        both = visib & seen
        assert both.sum() > 20
        error = np.abs(depth[both] - own[both])
        # Half a step of the 16-bit picture; grazed edges as above.
        limit = camera["depth_scale"] / 2 + 1e-3
        assert np.count_nonzero(error > limit) <= 2
        visible |= visib
    np.testing.assert_array_equal(depth > 0, visible)


class TestBop:
    def test_layout(self, bop_out, bop_scene):
        place, files = bop_scene
        names = {str(p.relative_to(place)) for p in place.rglob("*") if p.is_file()}
        assert {"gray/000002.png", "depth/000002.png", "mask/000001_000001.png"} <= names
        assert {"mask_visib/000001_000000.png", "frames/000000_005.png"} <= names
        for content in files.values():
            assert list(content) == ["0", "1", "2"]
        assert (bop_out / "camera.json").is_file()
        # Three blocks of different height, and the ball of one sample.
        models = sorted(p.name for p in (bop_out / "models").glob("*.ply"))
        assert models == [f"obj_{n:06d}.ply" for n in range(1, 5)]

    def test_models_project_onto_masks_and_depth(self, bop_out, bop_scene):
        for image in ("0", "1"):
            check_projection(bop_out, *bop_scene, image)

    def test_counts_and_boxes(self, bop_scene):
        place, files = bop_scene
        for image, entries in files["gt_info"].items():
            for number, entry in enumerate(entries):
                name = f"{int(image):06d}_{number:06d}.png"
                mask, visib = read(place / "mask" / name) > 0, read(place / "mask_visib" / name) > 0
                assert entry["px_count_visib"] == visib.sum()
                assert entry["px_count_all"] >= mask.sum()
                assert entry["visib_fract"] == visib.sum() / entry["px_count_all"]
                rows, columns = np.nonzero(visib)
                assert entry["bbox_visib"] == [
                    columns.min(),
                    rows.min(),
                    columns.max() - columns.min(),
                    rows.max() - rows.min(),
                ]
                assert entry["px_count_valid"] == mask.sum()
        block, ball = files["gt_info"]["1"]
        assert block["visib_fract"] < 1.0  # the ball is before it
        assert ball["visib_fract"] == 1.0

    def test_world_and_model_poses_agree(self, bop_scene, data):
        _, files = bop_scene
        for image, poses in files["gt"].items():
            camera = files["camera"][image]
            turn, shift = np.reshape(camera["cam_R_w2c"], (3, 3)), camera["cam_t_w2c"]
            for placed, pose in zip(data[int(image)].scene.objects, poses, strict=True):
                middle = placed.artefact.mesh.bounds.mean(axis=0)
                wanted = turn @ placed.pose.to_world(middle) + shift
                np.testing.assert_allclose(pose["cam_t_m2c"], wanted, atol=1e-9)

    def test_models_info(self, bop_out):
        information = json.loads((bop_out / "models/models_info.json").read_text())
        for number, entry in information.items():
            model = trimesh.load(bop_out / f"models/obj_{int(number):06d}.ply", process=False)
            low, high = model.bounds
            # Single precision of the PLY.
            np.testing.assert_allclose([entry[f"min_{a}"] for a in "xyz"], low, atol=1e-5)
            np.testing.assert_allclose([entry[f"size_{a}"] for a in "xyz"], high - low, atol=1e-5)
            np.testing.assert_allclose(low + high, 0, atol=1e-5)
            points = model.vertices[:, None] - model.vertices[::1]
            assert entry["diameter"] == pytest.approx(np.linalg.norm(points, axis=-1).max())

    def test_projector_extension(self, bop_scene, data):
        place, files = bop_scene
        for image, entry in files["projector"].items():
            rig = data[int(image)].rig
            camera = files["camera"][image]
            depth = read(place / f"depth/{int(image):06d}.png") * camera["depth_scale"]
            truth = data[int(image)].truth
            v, u = np.nonzero(truth.lit)
            pixels = np.stack((u, v, np.ones_like(u)), axis=-1)
            points = pixels @ np.linalg.inv(np.reshape(camera["cam_K"], (3, 3))).T
            points = points * depth[v, u][:, None]
            seen, _ = cv2.projectPoints(
                points,
                np.reshape(entry["R_c2p"], (3, 3)),
                np.array(entry["t_c2p"]),
                np.reshape(entry["proj_K"], (3, 3)),
                np.array(entry["proj_dist"]),
            )
            # Half a step of depth (10 um at 800 mm), seen under the triangulation angle.
            np.testing.assert_allclose(seen[:, 0], truth.panel[v, u], atol=0.05)
            assert entry["proj_size"] == [rig.projector.width, rig.projector.height]
            item = data[int(image)]
            frames = item.capture("1,10", seed=RECIPE.seed_of(item)).frames
            for frame, file in zip(frames, entry["frames"], strict=True):
                np.testing.assert_array_equal(read(place / file), frame)

    def test_telecentric_lenses_are_refused(self, data, tmp_path):
        item = data[0]
        lens = Lens.telecentric(0.1, 0.01, 300.0)
        item.__dict__["rig"] = item.rig.having(camera=replace(item.rig.camera, lens=lens))
        with pytest.raises(InputError, match="for BOP a perspective camera"):
            export(_only(data, [item]), tmp_path / "x", "bop", RECIPE)
        assert list(tmp_path.iterdir()) == []


#: At half the way from the middle of the picture to its corner.
DISTORTION = (0.8, 0.0, 0.01, -0.01, 0.0)


@pytest.mark.parametrize("form", ["bop", "coco"])
def test_the_fully_lit_picture_has_no_frame_errors(data, tmp_path, form):
    """Lost pictures lie beyond its end, and a cold lamp would leave it dark."""
    for name, faults in (
        ("clean", {}),
        ("faulty", {"trigger": Trigger(lost=(4, 9)), "drift": Drift(kind="warm-up", change=0.9)}),
    ):
        item = data[1]
        scene = replace(item.scene, exposure=replace(item.scene.exposure, **faults))
        item.__dict__.update(scene=scene, _settings=scene)
        export(_only(data, [item]), tmp_path / name, form, RECIPE)
    lit = "images/000001.png" if form == "coco" else "train/000000/gray/000000.png"
    clean, faulty = (read(tmp_path / name / lit) for name in ("clean", "faulty"))
    np.testing.assert_array_equal(faulty, clean)
    frame = lit.replace("images/", "frames/").replace("gray", "frames").replace(".png", "_004.png")
    clean, faulty = (read(tmp_path / name / frame) for name in ("clean", "faulty"))
    assert np.abs(faulty.astype(float) - clean).max() > 10.0  # what is learned from has them


def test_shorter_patterns_have_no_lost_pictures_beyond_their_end(data):
    item = data[1]
    exposure = replace(item.scene.exposure, trigger=Trigger(lost=(1, 4)))
    item.__dict__["_settings"] = replace(item.scene, exposure=exposure)
    np.testing.assert_array_equal(*item.capture("1@3", noise=False).frames[:2])
    with pytest.raises(InputError, match="lost"):  # of an exposure that is given with them
        item.capture("1@3", exposure=exposure)


@pytest.fixture(scope="module")
def bent():
    """A sample's number and scan, seen through a lens that moves corners by many pixels."""
    scene = small.result_of(1).scene
    camera = scene.rig.camera
    # Of so long a lens, whose corners are at 0.03 of the focal length, coefficients are large.
    scale = 2.0 / np.hypot(*camera.matrix[:2, 2] / np.diag(camera.matrix)[:2])
    strong = np.array(DISTORTION) * [scale**2, scale**4, scale, scale, 1.0]
    rig = scene.rig.having(camera=replace(camera, distortion=tuple(strong), tilt_rad=(0.02, -0.03)))
    return scan(replace(scene, rig=rig), seed=small.seed_of(1))


class TestUndistorted:
    @pytest.fixture
    def exported(self, bent, data, tmp_path):
        item = data[1]
        new = {"rig": bent.scene.rig, "truth": bent.truth, "transport": bent.transport}
        item.__dict__.update(new, scene=bent.scene, _settings=bent.scene)
        recipe = Recipe("1,8@4", noise=False)
        export(_only(data, [item]), tmp_path / "bop", "bop", recipe)
        place = tmp_path / "bop" / "train" / "000000"
        files = {
            name: json.loads((place / f"scene_{name}.json").read_text())
            for name in ("camera", "gt", "projector")
        }
        return tmp_path / "bop", place, files, recipe.shots(item)

    @staticmethod
    def on_sensor(camera):
        """Where the pinhole's pixels stand on the sensor, by the rig's own projection."""
        v, u = np.indices((camera.height, camera.width))
        rays = np.stack((u, v, np.ones_like(u)), axis=-1) @ np.linalg.inv(camera.matrix).T
        return camera.project(camera.pose.to_world(rays.reshape(-1, 3))).reshape(*u.shape, 2)

    def test_the_lens_does_bend(self, bent):
        camera = bent.scene.rig.camera
        v, u = np.indices((camera.height, camera.width))
        moved = np.linalg.norm(self.on_sensor(camera) - np.stack((u, v), axis=-1), axis=-1)
        assert moved.max() > 3.0

    def test_models_project_onto_masks_and_depth(self, exported, bent):
        folder, place, files, _ = exported
        camera = bent.scene.rig.camera
        seen = self.on_sensor(camera)
        inside = (seen >= 0) & (seen <= [camera.width - 1, camera.height - 1])
        check_projection(folder, place, files, "0", inside.all(axis=-1))

    def test_fringes_are_where_the_depth_says(self, exported, bent):
        """Decode the undistorted frames and compare with the points that depth stands for."""
        _, place, files, shots = exported
        entry, camera = files["projector"]["0"], files["camera"]["0"]
        depth = read(place / "depth/000000.png") * camera["depth_scale"]
        v, u = np.nonzero(depth)
        rays = np.stack((u, v, np.ones_like(u)), axis=-1)
        rays = rays @ np.linalg.inv(np.reshape(camera["cam_K"], (3, 3))).T
        wanted, _ = cv2.projectPoints(
            rays * depth[v, u][:, None],
            np.reshape(entry["R_c2p"], (3, 3)),
            np.array(entry["t_c2p"]),
            np.reshape(entry["proj_K"], (3, 3)),
            np.array(entry["proj_dist"]),
        )
        straight = np.array([read(place / file) for file in entry["frames"]])
        errors = {}
        for name, frames in (("undistorted", straight), ("as seen", shots.frames)):
            phase = replace(shots, frames=frames).decode()
            error = np.abs(phase.coordinate["u"][v, u] - wanted[:, 0, 0])[phase.mask[v, u]]
            assert error.size > 100
            errors[name] = np.median(error)
        # A camera pixel sees 6.8 panel pixels: interpolation between pixels is good to a twentieth
        # of one; half the way to the object's edge the lens moves the picture by half a pixel.
        assert errors["undistorted"] < 0.34
        assert errors["as seen"] > 3.4

    def test_what_was_taken_out_is_told(self, exported, bent):
        told = exported[2]["projector"]["0"]["camera_dist"]
        np.testing.assert_allclose(told, bent.scene.rig.camera.opencv_distortion)


class TestGeometry:
    def test_depth_of_a_tilted_square(self):
        # A plane z = 100 + x / 2 before a camera of 100 px focal length.
        points = np.array([[-20, -20, 90], [20, -20, 110], [20, 20, 110], [-20, 20, 90.0]])
        matrix = np.array([[100.0, 0, 31.5], [0, 100.0, 23.5], [0, 0, 1]])
        for faces in ([[0, 1, 2], [0, 2, 3]], [[2, 1, 0], [3, 2, 0]]):
            depth = depth_of_mesh(points, faces, matrix, (64, 48))
            v, u = np.nonzero(depth)
            wanted = 100 / (1 - 0.5 * (u - 31.5) / 100)
            np.testing.assert_allclose(depth[v, u], wanted, rtol=1e-12)
            # No seam, and the edges where geometry puts them: x = -20 at z = 90.
            assert u.min() == np.ceil(31.5 - 2000 / 90)
            assert u.max() == np.floor(31.5 + 2000 / 110)
            assert len(u) == np.count_nonzero(depth[:, u.min() : u.max() + 1])

    def test_the_nearer_surface_counts(self):
        near = np.array([[-5, -5, 50], [5, -5, 50], [0, 5, 50.0]])
        far = near * [4, 4, 2]
        matrix = np.array([[50.0, 0, 16], [0, 50.0, 16], [0, 0, 1]])
        points = np.concatenate((far, near))
        depth = depth_of_mesh(points, [[0, 1, 2], [3, 4, 5]], matrix, (33, 33))
        assert set(np.unique(depth).round(9)) == {0.0, 50.0, 100.0}

    def test_a_mesh_behind_the_camera(self):
        with pytest.raises(InputError, match="in front of the camera"):
            depth_of_mesh([[0, 0, -1], [1, 0, 1], [0, 1, 1.0]], [[0, 1, 2]], np.eye(3), (4, 4))

    def test_diameter(self):
        rng = np.random.default_rng(0)
        for points in (
            rng.normal(size=(400, 3)),
            np.column_stack((rng.uniform(size=(300, 2)), np.zeros(300))),  # flat
            np.array([[0, 0, 0], [3, 4, 0.0]]),
        ):
            wanted = np.linalg.norm(points[:, None] - points, axis=-1).max()
            assert diameter(points) == pytest.approx(wanted, rel=1e-12)

    def test_box(self):
        mask = np.zeros((10, 12), bool)
        mask[3:6, 4:9] = True
        assert box(mask) == [4, 3, 4, 2]
        assert box(mask, (5, 5)) == [-1, -2, 4, 2]
        assert box(np.zeros((3, 3), bool)) == [-1, -1, -1, -1]


class TestRefusals:
    @pytest.mark.parametrize("form", ["frames", "bop", "hdf5"])
    def test_a_target_that_exists(self, data, tmp_path, form):
        target = tmp_path / "taken.h5"
        if form == "hdf5":
            target.write_bytes(b"mine")
        else:
            target.mkdir()
            (target / "mine").touch()
        with pytest.raises(InputError, match="taken"):
            export(data, target, form, RECIPE)
        assert target.is_file() or [p.name for p in target.iterdir()] == ["mine"]

    @pytest.mark.parametrize("form", ["frames", "bop", "hdf5"])
    def test_a_damaged_sample_leaves_nothing(self, data, tmp_path, form):
        rows = [dict(row) for row in data.rows[:2]]
        rows[1]["sha256"] = "0" * 64
        broken = replace(data, rows=tuple(rows))
        with pytest.raises(InputError, match="sample 000001"):
            export(broken, tmp_path / "x.h5", form, RECIPE)
        assert list(tmp_path.iterdir()) == []

    def test_nothing_selected(self, data, tmp_path):
        with pytest.raises(InputError, match="at least one sample"):
            export(data.where("height_mm > 99"), tmp_path / "x", "frames", RECIPE)

    def test_no_stored_frames(self, tmp_path):
        bare = datasets.open_dataset(small.write_dataset(tmp_path / "bare", frames=False))
        with pytest.raises(InputError, match="capture"):
            export(bare, tmp_path / "x", "frames")
        assert not (tmp_path / "x").exists()

    def test_recipes(self):
        with pytest.raises(InputError, match="seed"):
            Recipe("1", seed=-1)
        with pytest.raises(InputError, match="detector"):
            Recipe(None, detector=small.result_of(0).scene.detector)


class TestCommand:
    def test_a_selection_as_frames(self, folder, tmp_path):
        out = tmp_path / "x"
        where = "height_mm > 4.5 and kind == 'step_block'"
        outcome = run_cli(
            "dataset",
            "export",
            folder,
            "--out",
            out,
            "--where",
            where,
            "--patterns",
            "1,10",
            "--json",
        )
        assert outcome.status == 0, outcome.err
        assert json.loads(outcome.out)["samples"] == 2
        assert read_rig(out / "000003" / "rig.yaml").camera.width == 64
        assert (out / "provenance.json").is_file()

    @pytest.mark.parametrize("form", ["frames", "hdf5"])
    def test_parts_have_no_object_in_common(self, folder, data, tmp_path, form):
        out = tmp_path / "parts"
        words = ["--split", "train=0.5", "--split", "test=0.5", "--patterns", "1", "--json"]
        outcome = run_cli("dataset", "export", folder, "--out", out, "--format", form, *words)
        assert outcome.status == 0, outcome.err
        said = json.loads(outcome.out)
        assert (said["samples"], said["parts"]) == (8, {"train": 4, "test": 4})
        objects = {row["sample"]: row["object"] for row in data.rows}
        written = {}
        for name in ("train", "test"):
            if form == "frames":
                with (out / name / "index.csv").open() as stream:
                    written[name] = [int(row["sample"]) for row in csv.DictReader(stream)]
            else:
                with h5py.File(out / f"{name}.h5") as file:
                    written[name] = file["sample"][:].tolist()
        train, test = ({objects[k] for k in written[name]} for name in written)
        assert sorted(written["train"] + written["test"]) == sorted(objects)
        assert not train & test
        # The parts that Python gives.
        parts = data.split(train=0.5, test=0.5)
        assert written == {name: [item.number for item in part] for name, part in parts.items()}

    def test_a_part_that_cannot_be_written_leaves_nothing(self, tmp_path):
        bare = small.write_dataset(tmp_path / "bare", frames=False)
        words = ["--split", "a=0.5", "--split", "b=0.5"]
        check_refused(
            run_cli("dataset", "export", bare, "--out", tmp_path / "x", *words), "capture"
        )
        assert not (tmp_path / "x").exists()

    @pytest.mark.parametrize(
        ("options", "word"),
        [
            (["--split", "train"], "--split"),
            (["--split", "../x=0.5"], "--split"),
            (["--split", "a=0.5", "--split", "a=0.5"], "--split"),
            (["--split", "seed=0.5"], "--split"),
            (["--split", "a=0.9", "--split", "b=0.9"], "sum to 1"),
            (["--split", "a=1.5"], "(0, 1]"),
            (["--format", "zip", "--split", "a=1"], "--format"),
            (["--format", "zip"], "--format"),
            (["--where", "heigth_mm > 1"], "heigth_mm"),
            (["--patterns", "1,x"], "patterns"),
            (["--format", "hdf5"], ".h5"),
        ],
    )
    def test_bad_options_before_any_work(self, folder, tmp_path, options, word):
        check_refused(run_cli("dataset", "export", folder, "--out", tmp_path / "x", *options), word)
        assert list(Path(tmp_path).iterdir()) == []
