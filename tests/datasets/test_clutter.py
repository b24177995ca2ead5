"""Several objects a sample: counts, resting poses, own materials, distractors, instance masks."""

import hashlib
import json
import tomllib

import cv2
import numpy as np
import pytest
from dataset_specs import TINY, rows_of, write_spec
from scipy import stats
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from slbench import objects
from slbench.core.errors import InputError
from slbench.datasets.export.formats import export
from slbench.datasets.make.cluster import local_cluster
from slbench.datasets.make.engine import make_dataset
from slbench.datasets.read.reader import open_dataset
from slbench.datasets.read.recipe import Recipe
from slbench.datasets.spec.clutter import Clutter, Resting
from slbench.datasets.spec.sampling import check, draw, place_scene
from slbench.datasets.spec.specification import load
from slbench.datasets.verify import verify_dataset

HEIGHT = -8.0
STAGE = {"artefact": "plane", "position_mm": [0.0, 0.0, HEIGHT], "distractor": True}
BLOCK = {
    "name": "block",
    "weight": 2,
    "kind": "step_block",
    "material": {"choice": ["paint", "grey-plastic"]},
    "parameters": {
        "heights_mm": [{"uniform": [1.0, 5.0], "name": "step_mm"}],
        "step_length_mm": {"integers": [5, 8]},
        "width_mm": 8.0,
    },
}
BALL = {
    "name": "ball",
    "kind": "sphere",
    "material": "paint",
    "parameters": {"radius_mm": {"uniform": [4.0, 6.0]}, "max_form_error_um": 500.0},
}
MATERIALS = {"paint": {"bsdf": "diffuse", "albedo": {"uniform": [0.3, 0.9]}}}
CLUTTER = {
    "scene": TINY["scene"] | {"objects": [STAGE]},
    "objects": [BLOCK, BALL],
    "distractors": [{"name": "thing", "kind": "step_block", "parameters": BLOCK["parameters"]}],
    "materials": MATERIALS,
    "clutter": {"count": [1, 3], "distractors": [0, 2], "height_mm": HEIGHT},
    "patterns": [{"sequence": "1,10"}],
    "constraints": {"min_lit_share": 0.001},
}


def changed(**clutter):
    return CLUTTER | {"clutter": CLUTTER["clutter"] | clutter}


def loaded(folder, **content):
    folder.mkdir(exist_ok=True)
    return load(write_spec(folder, **content))


@pytest.fixture(scope="module")
def specification(tmp_path_factory):
    return loaded(tmp_path_factory.mktemp("spec"), **CLUTTER)[0]


def scenes(specification, folder, samples, seed=1):
    """Yield draws and their scenes, those left out for which there is no room."""
    for sample in samples:
        drawn = draw(specification, seed, sample)
        here = folder / f"{sample}"
        here.mkdir()
        try:
            scene = place_scene(drawn, {}, here, True)
        except InputError as error:
            if "room" not in str(error):
                raise
            continue
        yield drawn, scene


# -- what is drawn ------------------------------------------------------------------------------


def test_specifications_without_clutter_draw_what_they_drew(tmp_path):
    """Values and tables of ten draws, as of the commit before there was clutter."""
    tiny, _ = load(write_spec(tmp_path))
    tables = [vars(draw(tiny, 5, sample))["table"] for sample in range(10)]
    values = [draw(tiny, 5, sample).values for sample in range(10)]
    text = json.dumps([tables, values], default=str)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "f34ec8201cfe0402"
    assert {"clutter", "distractors", "materials", "instances"}.isdisjoint(
        tiny.model_dump(exclude_none=True)
    )


def test_counts_are_uniform_and_kinds_by_weight(specification):
    """Chi-square and binomial tests at 1e-4 false alarm, with a fixed seed."""
    draws = [draw(specification, 3, sample).values for sample in range(900)]
    for name, possible in (("count", (1, 2, 3)), ("distractors", (0, 1, 2))):
        found = [sum(values[name] == k for values in draws) for k in possible]
        assert sum(found) == 900
        assert stats.chisquare(found).pvalue > 1e-4
    later = [values["kind_2"] for values in draws if values["count"] == 3]
    blocks = sum(kind == "block" for kind in later)
    assert stats.binomtest(blocks, len(later), 2.0 / 3.0).pvalue > 1e-4


def test_more_objects_leave_the_first_ones_as_they_are(specification, tmp_path):
    more, _ = loaded(tmp_path, **changed(count=6, distractors=4))
    for sample in range(20):
        few, many = draw(specification, 1, sample), draw(more, 1, sample)
        assert many.wanted == 6
        assert few.kind == many.kind
        own = {k: v for k, v in few.values.items() if k not in ("count", "distractors")}
        assert own == {k: many.values[k] for k in own}


def test_each_object_has_columns_and_a_material_of_its_own(specification, tmp_path):
    columns = specification.drawn_columns()
    for slot in ("", "_1", "_2"):
        assert {f"step_mm{slot}", f"radius_mm{slot}", f"albedo{slot}"} <= set(columns)
    assert {"count", "distractors", "kind_1", "kind_2", "kind_d0", "step_mm_d1"} <= set(columns)
    assert {"radius_mm_d0", "step_mm_3", "kind_0", "kind"}.isdisjoint(columns)
    albedos = []
    for drawn, scene in scenes(specification, tmp_path, range(12)):
        assert set(drawn.values) <= set(columns)
        for k, slot in enumerate(("", "_1", "_2")[: drawn.wanted]):
            kind = drawn.kind if k == 0 else drawn.values[f"kind{slot}"]
            assert scene.objects[k].artefact.kind == {"block": "step_block", "ball": "sphere"}[kind]
            if f"albedo{slot}" in drawn.values:
                albedo = scene.objects[k].material.bsdf.albedo
                assert albedo == drawn.values[f"albedo{slot}"]
                albedos.append(albedo)
    assert len(set(albedos)) == len(albedos) > 8


def test_distractors_and_the_stage_are_flagged(specification, tmp_path):
    for drawn, scene in scenes(specification, tmp_path, range(6)):
        flags = [item.distractor for item in scene.objects]
        assert flags == [False] * drawn.wanted + [True] * (drawn.values["distractors"] + 1)


# -- how it rests -------------------------------------------------------------------------------


def test_objects_rest_on_the_table_apart(specification, tmp_path):
    """By vertices alone: the lowest ones carry the centre of mass, and outlines are apart."""
    seen = 0
    for drawn, scene in scenes(specification, tmp_path, range(12)):
        count = drawn.wanted + drawn.values["distractors"]
        outlines = []
        for item in scene.objects[:count]:
            vertices = item.pose.to_world(item.artefact.mesh.vertices)
            assert vertices[:, 2].min() == pytest.approx(HEIGHT, abs=1e-9)
            assert np.all(np.abs(vertices[:, :2]) <= [30.0 + 1e-9, 35.0 + 1e-9])  # the volume
            centre = item.pose.to_world(item.artefact.mesh.as_trimesh.center_mass)
            # A polygon in a circle is a facet only to some error of its corners.
            foot = vertices[vertices[:, 2] < HEIGHT + 1e-6][:, :2]
            hull = ConvexHull(foot)
            inside = hull.equations[:, :2] @ centre[:2] + hull.equations[:, 2]
            assert inside.max() < 1e-6
            outlines.append(vertices[:, :2])
            seen += 1
        for k, one in enumerate(outlines):
            for other in outlines[:k]:
                assert separation(one, other) > 1.0 - 1e-9  # gap_mm
    assert seen > 25


def separation(one, other):
    """Return the distance of two convex outlines, or a lower one: over edges' normals."""
    widest = -np.inf
    for points in (one, other):
        hull = ConvexHull(points)
        for normal in np.concatenate([hull.equations[:, :2], _between(one, other)]):
            widest = max(widest, (other @ normal).min() - (one @ normal).max())
            widest = max(widest, (one @ normal).min() - (other @ normal).max())
    return widest


def _between(one, other):
    """Return unit vectors from each corner of one hull to each of the other, (n, 2)."""
    a, b = one[ConvexHull(one).vertices], other[ConvexHull(other).vertices]
    steps = (b[None] - a[:, None]).reshape(-1, 2)
    return steps / np.linalg.norm(steps, axis=1, keepdims=True)


def test_a_cuboid_falls_on_its_sides_by_their_solid_angles():
    """All six sides are stable: each has the solid angle that it takes from the centre.

    Goldberg et al.'s estimate for a body whose facets are all stable.  Chi-square at 1e-4.
    """
    a, b, c = 10.0, 20.0, 30.0
    block = {"size_mm": [a, b], "thickness_mm": c}
    artefact = objects.build_artefact("plane", block)
    sides = {0: (b, c, a), 1: (a, c, b), 2: (a, b, c)}  # along which axis it stands up
    angle = {
        axis: 4.0 * np.arcsin(x * y / np.sqrt((x * x + z * z) * (y * y + z * z)))
        for axis, (x, y, z) in sides.items()
    }
    assert 2.0 * sum(angle.values()) == pytest.approx(4.0 * np.pi)
    counts, turns, n = np.zeros((3, 2)), [], 1200
    for k in range(n):
        (pose,) = Resting(1, (7, k), Clutter(area_mm=(90.0, 90.0))).poses([artefact], (1.0, 1.0))
        matrix = Rotation.from_euler("XYZ", pose["rotation_deg"], degrees=True).as_matrix()
        up = matrix[2]  # of the object's axes, which one is upright
        axis = int(np.argmax(np.abs(up)))
        assert abs(up[axis]) == pytest.approx(1.0, abs=1e-9)
        counts[axis, int(up[axis] > 0)] += 1
        across = matrix[:2, (axis + 1) % 3]
        turns.append(np.arctan2(across[1], across[0]))
    expected = np.repeat([[angle[k]] for k in range(3)], 2, axis=1) / (4.0 * np.pi) * n
    assert stats.chisquare(counts.ravel(), expected.ravel()).pvalue > 1e-4
    assert stats.kstest(turns, stats.uniform(-np.pi, 2.0 * np.pi).cdf).pvalue > 1e-4


def test_poses_follow_from_seed_sample_and_draw(specification, tmp_path):
    for name in ("one", "again"):
        (tmp_path / name).mkdir()
    drawn = draw(specification, 1, 0)
    one, again = (place_scene(drawn, {}, tmp_path / n, False) for n in ("one", "again"))
    for a, b in zip(one.objects, again.objects, strict=True):
        assert a.pose.position.tobytes() == b.pose.position.tobytes()
        assert a.pose.rotation.tobytes() == b.pose.rotation.tobytes()
    (tmp_path / "next").mkdir()
    other = place_scene(draw(specification, 1, 0, 1), {}, tmp_path / "next", False)
    assert not np.allclose(one.objects[0].pose.position, other.objects[0].pose.position)


def test_stated_poses_are_taken_as_they_are(tmp_path):
    lying = BLOCK | {"position_mm": [{"uniform": [-5.0, 5.0]}, 2.0, 0.0]}
    content = CLUTTER | {"objects": [lying], "clutter": {"count": 2, "poses": "stated"}}
    specification, _ = loaded(tmp_path / "spec", **content | {"distractors": None})
    ((drawn, scene),) = scenes(specification, tmp_path, [0])
    places = [drawn.values["x_mm"], drawn.values["x_mm_1"]]
    assert places[0] != places[1]
    for item, x in zip(scene.objects, places, strict=False):
        np.testing.assert_array_equal(item.pose.position, [x, 2.0, 0.0])


# -- refusals -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (changed(count=[3, 1]), ["clutter", "count", "least number first"]),
        (changed(count=0), ["clutter", "count", "1 or more"]),
        (changed(count=33), ["clutter", "count"]),
        (changed(cuont=3), ["clutter", "cuont"]),
        (changed(poses="stated"), ["height_mm", "resting"]),
        (changed(distractors=0), ["distractors"]),
        (CLUTTER | {"distractors": None}, ["distractors"]),
        (CLUTTER | {"objects": None}, ["objects"]),
        (
            CLUTTER | {"objects": [BLOCK | {"position_mm": [0.0, 0.0, 0.0]}]},
            ["objects[0].position_mm", "rests on the table", "stated"],
        ),
        (
            CLUTTER | {"distractors": [BLOCK | {"rotation_deg": [0.0, 0.0, 0.0]}]},
            ["distractors[0].rotation_deg"],
        ),
        (CLUTTER | {"objects": [BLOCK, BLOCK]}, ["objects", "a name of its own"]),
        (
            CLUTTER
            | {"materials": {"paint": {"albedo": {"uniform": [0.1, 0.2], "name": "step_mm"}}}},
            ["step_mm", "a name other than"],
        ),
    ],
)
def test_refusals_name_what_is_wrong(tmp_path, content, words):
    with pytest.raises(InputError) as caught:
        load(write_spec(tmp_path, **content))
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (changed(area_mm=[5.0, 5.0]), ["room on 5 x 5 mm", "object 1 of 1", "mm"]),
        (
            changed(count=3, area_mm=[18.0, 20.0], distractors=2),
            ["a draw of", "room on 18 x 20 mm"],
        ),
        (
            CLUTTER | {"materials": {"paint": {"bsdf": "diffuse", "albdo": 0.5}}},
            ["albdo"],
        ),
        (
            CLUTTER | {"distractors": [BLOCK | {"material": "no-such"}]},
            ["distractors[0]", "no-such"],
        ),
        (
            CLUTTER | {"scene": CLUTTER["scene"] | {"exposure": {"trigger": {"lost": [6]}}}},
            ["exposure.trigger.lost", "pictures 0 to 5", "6"],
        ),
    ],
)
def test_what_no_draw_can_make_is_refused_before_rendering(tmp_path, content, words):
    specification, files = loaded(tmp_path / "spec", **content)
    with pytest.raises(InputError) as caught:
        check(specification, files, 0, False, tmp_path)
    assert all(word in str(caught.value) for word in words), str(caught.value)


# -- samples ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("spec")
    spec = write_spec(folder, **changed(count=[2, 3], distractors=1))
    url = tmp_path_factory.mktemp("data") / "set"
    with local_cluster(0) as cluster:
        result = make_dataset(*load(spec), str(url), 3, cluster, seed=4)
    assert result.failed == 0
    return url


@pytest.fixture(scope="module")
def data(made):
    return open_dataset(made)


class TestSamples:
    def test_all_is_well(self, made):
        problems, _ = verify_dataset(str(made))
        assert problems == []
        for row in rows_of(made):
            assert 2 <= row["count"] <= 3
            assert row["kind_1"] in ("block", "ball")
            assert (row["kind_2"] is None) == (row["count"] == 2)

    def test_instance_masks_are_the_ground_truths(self, data):
        for item in data:
            # Read by OpenCV: 16 bit, 0 for nothing, k + 1 for object k.
            mask = cv2.imdecode(np.frombuffer(item.member("instances.png"), np.uint8), -1)
            assert mask.dtype == np.uint16
            np.testing.assert_array_equal(mask.astype(int) - 1, item.truth.object_id)
            np.testing.assert_array_equal(mask, item.instances)
            assert item.instances.dtype == np.uint16
            assert set(range(1, item.row["count"] + 1)) <= set(np.unique(mask))

    def test_a_lost_mask_is_found(self, data):
        """The mask is one of the members that verify asks for."""
        from slbench.datasets.store.sample import pack
        from slbench.datasets.verify import _contents

        item = data[0]
        members = {k: v for k, v in item.members.items() if k != "instances.png"}
        (problem,) = _contents(data.manifest, item.row, pack(item.number, members))
        assert "instances.png" in problem

    def test_object_pixels_are_those_of_the_drawn_objects(self, data):
        for item in data:
            wanted = (item.truth.object_id >= 0) & (item.truth.object_id < item.row["count"])
            assert item.row["object_pixels"] == np.count_nonzero(wanted & item.truth.lit)

    def test_the_scene_file_is_complete(self, data):
        for item in data:
            content = tomllib.loads(item.member("scene.toml").decode())
            assert len(content["objects"]) == item.row["count"] + 2
            assert all(len(one["position_mm"]) == 3 for one in content["objects"])
            used = {one.get("material") for one in content["objects"]} - {None, "grey-plastic"}
            assert used == set(content.get("materials", {}))

    def test_growing_gives_the_same_bytes(self, made, data, tmp_path):
        spec = write_spec(tmp_path, **changed(count=[2, 3], distractors=1))
        for count in (1, 3):
            with local_cluster(0) as cluster:
                given = (*load(spec), str(tmp_path / "grown"), count, cluster)
                make_dataset(*given, seed=4, resume=count > 1)
        for name in ("dataset.json", "index.parquet", "shards/000000.tar", "shards/000001.tar"):
            assert (tmp_path / "grown" / name).read_bytes() == (made / name).read_bytes()

    def test_coco_annotates_what_is_of_interest(self, data, tmp_path):
        export(data, tmp_path / "coco", "coco", Recipe("1,10", noise=False))
        content = json.loads((tmp_path / "coco" / "annotations.json").read_text())
        for item in data:
            own = [one for one in content["annotations"] if one["image_id"] == item.number]
            assert [one["area"] for one in own] == [
                np.count_nonzero(item.truth.object_id == k) for k in range(item.row["count"])
            ]
        assert {one["name"] for one in content["categories"]} <= {"step_block", "sphere"}

    def test_bop_has_poses_and_masks_of_what_is_of_interest(self, data, tmp_path):
        export(data, tmp_path / "bop", "bop", Recipe("1,10", noise=False))
        place = tmp_path / "bop" / "train" / "000000"
        poses = json.loads((place / "scene_gt.json").read_text())
        info = json.loads((place / "scene_gt_info.json").read_text())
        for image, item in enumerate(data):
            count = item.row["count"]
            assert len(poses[str(image)]) == len(info[str(image)]) == count
            names = {path.name for path in (place / "mask_visib").glob(f"{image:06d}_*")}
            assert names == {f"{image:06d}_{k:06d}.png" for k in range(count)}
            for k in range(count):
                mask = cv2.imread(str(place / "mask_visib" / f"{image:06d}_{k:06d}.png"), -1)
                np.testing.assert_array_equal(mask > 0, item.truth.object_id == k)
                assert info[str(image)][k]["px_count_visib"] == np.count_nonzero(mask)


def test_masks_are_left_to_who_asks_for_them(tmp_path):
    """Samples of older specifications keep their members; `instances` asks for the mask."""
    plain, _ = load(write_spec(tmp_path))
    asked, _ = load(write_spec(tmp_path, instances=True))
    assert (plain.has_instances, asked.has_instances) == (False, True)
