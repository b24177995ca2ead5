"""Layouts that others train on, read back as their own readers read them."""

import json
import re
from pathlib import Path

import cv2
import datasets_small as small
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import scipy.sparse
from dataset_specs import write_spec
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from outside_loaders import loader
from PIL import Image
from scenes_small import check_refused, run_cli
from stages import trace

from slbench import datasets
from slbench.cloud import read_cloud
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError
from slbench.datasets.export.coco import run_lengths
from slbench.datasets.export.formats import export
from slbench.datasets.export.frames import eight_bit
from slbench.datasets.export.light_transport import read_light_transport
from slbench.datasets.read.recipe import Recipe
from slbench.detector import Detector
from slbench.simulate.transport import LightTransport

RECIPE = Recipe("1,10", seed=3)


def read(path):
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


@pytest.fixture(scope="module")
def coco_out(folder, tmp_path_factory):
    target = tmp_path_factory.mktemp("coco") / "out"
    export(datasets.open_dataset(folder)[:3], target, "coco", RECIPE)
    return target


@pytest.fixture(scope="module")
def content(coco_out):
    return json.loads((coco_out / "annotations.json").read_text())


class TestCoco:
    def test_masks_are_the_ground_truths(self, content, data):
        """By the definition of run lengths alone."""
        expected = {
            (item.number, number): item.truth.object_id == number
            for item in data[:3]
            for number in range(len(item.scene.objects))
        }
        found = {}
        for one in content["annotations"]:
            rle = one["segmentation"]
            values = np.resize([False, True], len(rle["counts"]))
            mask = np.repeat(values, rle["counts"]).reshape(rle["size"], order="F")
            earlier = sum(image == one["image_id"] for image, _ in found)
            found[one["image_id"], earlier] = mask
            rows, columns = np.nonzero(mask)
            left, top = columns.min(), rows.min()
            size = [np.ptp(columns) + 1, np.ptp(rows) + 1]
            assert one["bbox"] == [left, top, *size]
            assert one["area"] == mask.sum()
        assert found.keys() == expected.keys()
        for place, mask in expected.items():
            np.testing.assert_array_equal(found[place], mask)

    def test_pycocotools_reads_it(self, coco_out, data):
        loader("pycocotools")
        from pycocotools.coco import COCO

        read_back = COCO(str(coco_out / "annotations.json"))
        assert read_back.getImgIds() == [0, 1, 2]
        assert {one["name"] for one in read_back.loadCats(read_back.getCatIds())} == {
            "step_block",
            "sphere",
        }
        for item in data[:3]:
            ids = read_back.getAnnIds(imgIds=[item.number])
            kinds = [placed.artefact.kind for placed in item.scene.objects]
            assert len(ids) == len(kinds)
            for number, one in enumerate(read_back.loadAnns(ids)):
                mask = read_back.annToMask(one)
                np.testing.assert_array_equal(mask, item.truth.object_id == number)
                assert read_back.loadCats([one["category_id"]])[0]["name"] == kinds[number]

    @given(arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 7))))
    def test_run_lengths_are_those_of_pycocotools(self, mask):
        loader("pycocotools")
        from pycocotools import mask as coco

        packed = coco.frPyObjects({"size": list(mask.shape), "counts": run_lengths(mask)}, 0, 0)
        np.testing.assert_array_equal(coco.decode(packed), mask)
        assert packed["counts"] == coco.encode(np.asfortranarray(mask, np.uint8))["counts"]

    @given(arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 7))))
    def test_run_lengths_repeat_to_the_mask(self, mask):
        counts = run_lengths(mask)
        again = np.repeat(np.resize([False, True], len(counts)), counts)
        np.testing.assert_array_equal(again, mask.ravel(order="F"))
        assert all(n > 0 for n in counts[1:])

    def test_pictures_are_the_fully_lit_scene(self, coco_out, content, data):
        for image, item in zip(content["images"], data[:3], strict=True):
            picture = read(coco_out / image["file_name"])
            assert picture.dtype == np.uint8
            assert picture.shape == (image["height"], image["width"]) == item.truth.depth.shape
            assert picture[item.truth.lit].mean() > 3 * picture[item.truth.object_id < 0].mean()
            frames = eight_bit(item.capture("1,10", seed=RECIPE.seed_of(item)))
            for file, frame in zip(image["frames"], frames, strict=True):
                np.testing.assert_array_equal(read(coco_out / file), frame)

    def test_without_patterns_there_are_no_frames(self, data, tmp_path):
        export(data[:1], tmp_path / "out", "coco")
        content = json.loads((tmp_path / "out" / "annotations.json").read_text())
        assert "frames" not in content["images"][0]
        assert not (tmp_path / "out" / "frames").exists()


@pytest.fixture(scope="module")
def clouds_out(folder, tmp_path_factory):
    target = tmp_path_factory.mktemp("clouds") / "out"
    export(datasets.open_dataset(folder)[:2], target, "clouds", RECIPE)
    return target


class TestClouds:
    def test_what_is_measured(self, clouds_out, data):
        for item in data[:2]:
            shots = item.capture("1,10", seed=RECIPE.seed_of(item))
            wanted = triangulate(item.rig, shots.decode())
            cloud = read_cloud(clouds_out / f"{item.row['key']}.ply")
            # Single precision of the PLY, at some 30 mm.
            np.testing.assert_allclose(cloud.points, wanted.points, atol=1e-5)
            pixels = np.stack([cloud.scalars["u_px"], cloud.scalars["v_px"]], axis=-1)
            np.testing.assert_array_equal(pixels, wanted.pixels)
            np.testing.assert_allclose(cloud.scalars["sigma"], wanted.sigma_total_mm, rtol=1e-6)

    def test_what_is_true(self, clouds_out, data):
        for item in data[:2]:
            cloud = read_cloud(clouds_out / f"{item.row['key']}.truth.ply")
            u, v = (cloud.scalars[name].astype(int) for name in ("u_px", "v_px"))
            assert len(cloud.points) == np.count_nonzero(item.truth.lit)
            # Seen by the pixel that is named, to the single precision of 800 mm in 0.07 mm/px.
            seen = item.rig.camera.project(cloud.points)
            np.testing.assert_allclose(seen, np.stack([u, v], axis=-1), atol=2e-3)
            np.testing.assert_array_equal(cloud.scalars["object"], item.truth.object_id[v, u])
            np.testing.assert_allclose(cloud.normals, item.truth.normal[v, u], atol=1e-6)


class TestFringeDepth:
    @staticmethod
    def pairs(folder):
        """As ``FringeFPPDataset`` of FPP-ML-Bench reads a folder (``dataset.py``)."""
        for path in sorted((folder / "fringe").glob("*.png")):
            fringe = np.array(Image.open(path).convert("L"), dtype=np.float32) / 255.0
            depth = scipy.io.loadmat(folder / "depth" / f"{path.stem}.mat")["depth"]
            yield path.stem, fringe, depth.astype(np.float32)

    def test_a_pair_a_sample(self, data, tmp_path):
        export(data[:2], tmp_path / "out", "fringe-depth", Recipe("white", seed=3))
        found = list(self.pairs(tmp_path / "out"))
        assert [name for name, _, _ in found] == ["000000", "000001"]
        for (_, fringe, depth), item in zip(found, data[:2], strict=True):
            shots = item.capture("white", seed=Recipe("white", seed=3).seed_of(item))
            np.testing.assert_array_equal(np.rint(fringe * 255.0), eight_bit(shots)[0])
            there = np.isfinite(item.truth.depth)
            np.testing.assert_array_equal(depth > 0, there)
            np.testing.assert_array_equal(depth[there], item.truth.depth[there].astype(np.float32))

    def test_a_pair_a_frame(self, data, tmp_path):
        export(data[:1], tmp_path / "out", "fringe-depth", RECIPE)
        found = list(self.pairs(tmp_path / "out"))
        assert [name for name, _, _ in found] == [f"000000_{k:03d}" for k in range(6)]

    def test_twelve_bits_keep_their_leading_eight(self, data):
        deep = Detector(bit_depth=12)
        shots = data[0].capture("1,10", deep, noise=False)
        shallow = data[0].capture("1,10", Detector(bit_depth=8), noise=False)
        difference = eight_bit(shots).astype(int) - shallow.frames
        # 255/256 of it, and cut off instead of rounded.
        assert set(np.unique(difference)) <= {-1, 0, 1}

    def test_parts_stand_where_their_training_looks(self, folder, tmp_path):
        out = tmp_path / "training_data_depth_raw"
        words = ["--format", "fringe-depth", "--patterns", "white"]
        words += ["--split", "train=0.5", "--split", "val=0.25", "--split", "test=0.25"]
        outcome = run_cli("dataset", "export", folder, "--out", out, *words)
        assert outcome.status == 0, outcome.err
        counts = {part: len(list(self.pairs(out / part))) for part in ("train", "val", "test")}
        assert counts == {"train": 4, "val": 2, "test": 2}


#: Columns and types of the published files (``tests/conftest.py`` of learned-structured-light).
PUBLISHED = pa.schema(
    [
        ("sample_id", pa.string()),
        ("depth", pa.list_(pa.list_(pa.float32()))),
        ("occlusion", pa.list_(pa.list_(pa.bool_()))),
        ("ltm_rows", pa.list_(pa.uint32())),
        ("ltm_cols", pa.list_(pa.uint32())),
        ("ltm_values", pa.list_(pa.uint16())),
    ]
)


@pytest.fixture(scope="module")
def full():
    scene = small.result_of(1).scene
    return trace(scene, ("u", "uv"), seed=small.seed_of(1))


class TestLightTransport:
    @pytest.fixture
    def items(self, folder, full):
        chosen = datasets.open_dataset(folder)[:2]
        items = list(chosen)
        for item in items:
            item.__dict__["transport"] = full
        return chosen, items

    @pytest.fixture
    def path(self, items, tmp_path, monkeypatch):
        chosen, made = items
        monkeypatch.setattr(type(chosen), "__getitem__", lambda self, which: made[which])
        export(chosen, tmp_path / "out", "light-transport")
        (path,) = (tmp_path / "out").glob("*.parquet")
        return path

    def test_columns_are_those_of_the_published_files(self, path):
        assert re.fullmatch(r"train-(\d+)-of-(\d+)\.parquet", path.name).groups() == (
            "00000",
            "00001",
        )
        schema = pq.read_schema(path)
        for field in PUBLISHED:
            assert schema.field(field.name).type == field.type

    def test_their_reader_finds_the_picture(self, path, full, data):
        """As ``read_row_group`` and ``collate`` of learned-structured-light make it."""
        table = pq.ParquetFile(path).read_row_group(0)
        width, height = full.panel
        shape = full.ambient.size, width * height
        lists = {}
        for name in ("ltm_rows", "ltm_cols", "ltm_values"):
            column = table.column(name).combine_chunks()
            lists[name] = column.values.to_numpy()[: column.offsets[1].as_py()]
        place = lists["ltm_rows"].astype(np.int64) * shape[1] + lists["ltm_cols"]
        assert np.all(np.diff(place) > 0)  # they take them for sorted and unique
        values = lists["ltm_values"].astype(np.float32) / 65535
        matrix = scipy.sparse.coo_array((values, (lists["ltm_rows"], lists["ltm_cols"])), shape)
        panel = np.random.default_rng(0).uniform(size=(1, height, width))
        exact = (full.relight_images(panel) - full.ambient)[0]
        white = (full.relight_images(np.ones_like(panel)) - full.ambient)[0]
        found = (matrix @ panel.ravel()).reshape(exact.shape)
        # Half a step for each entry of a pixel's row; float32 sums of brightnesses up to 1.
        entries = np.diff(full.marginals["uv"].indptr).reshape(exact.shape)
        limit = entries / 2 / 65535 + 1e-5
        assert np.all(np.abs(found - exact / white.max()) <= limit)
        assert table["sample_id"].to_pylist() == ["000000", "000001"]
        depth = table.column("depth").combine_chunks().flatten().flatten().to_numpy()
        truth = data[0].truth
        np.testing.assert_allclose(
            depth[: truth.depth.size].reshape(truth.depth.shape) * 1e3,
            np.nan_to_num(truth.depth),
            rtol=1e-7,
        )
        lit = table.column("occlusion").combine_chunks().flatten().flatten()
        lit = lit.to_numpy(zero_copy_only=False)[: truth.lit.size]
        np.testing.assert_array_equal(lit.reshape(truth.lit.shape), truth.lit)

    def test_it_comes_back(self, path, full, data):
        again, depth, lit = read_light_transport(path, "000001")
        assert (again.panel, again.shape) == (full.panel, full.shape)
        truth = data[1].truth
        np.testing.assert_allclose(depth, truth.depth, rtol=1e-7)  # float32
        np.testing.assert_array_equal(lit, truth.lit)
        panels = np.random.default_rng(1).uniform(size=(3, full.panel[0]))
        image = np.repeat(panels[:, None], full.panel[1], axis=1)
        exact = full.relight_images(image) - full.ambient
        scale = (full.relight_images(np.ones_like(image[:1])) - full.ambient).max()
        entries = np.diff(full.marginals["uv"].indptr).reshape(full.shape)
        limit = (entries / 2 / 65535 + 1e-5) * scale  # as above
        for found in (again.relight_images(image), again.relight(panels)):
            assert np.all(np.abs(found - exact) <= limit)

    def test_a_published_file_is_read(self, tmp_path):
        rng = np.random.default_rng(2)
        rows = np.sort(rng.choice(256 * 256, size=5, replace=False)).astype(np.uint32)
        columns = rng.integers(0, 256 * 256, size=5).astype(np.uint32)
        values = rng.integers(1, 65535, size=5).astype(np.uint16)
        depth = rng.uniform(0.8, 1.0, size=(256, 256)).astype(np.float32)
        lit = rng.random((256, 256)) > 0.1
        row = {"sample_id": "train-07", "depth": depth.tolist(), "occlusion": lit.tolist()}
        row |= {"ltm_rows": rows, "ltm_cols": columns, "ltm_values": values}
        path = tmp_path / "train-00000-of-00001.parquet"
        pq.write_table(pa.Table.from_pylist([row], schema=PUBLISHED), path)
        found, found_depth, found_lit = read_light_transport(path)
        panel = rng.uniform(size=(256, 256))
        expected = np.zeros(256 * 256)
        expected[rows] = values / 65535 * panel.ravel()[columns]
        picture = found.relight_images(panel[None])[0]
        np.testing.assert_allclose(picture.ravel(), expected, rtol=1e-6)
        np.testing.assert_allclose(found_depth, depth * 1e3, rtol=1e-7)
        np.testing.assert_array_equal(found_lit, lit)
        page = (Path(__file__).parents[2] / "docs/how-to/datasets-use.md").read_text()
        part = page[page.index("**`light-transport`**") :]
        snippet = re.search(r"^```python\n(.*?)^```", part, re.M | re.S)[1]
        scope = {}
        exec(snippet.replace("test-00000-of-00020.parquet", str(path)), scope)
        np.testing.assert_array_equal(
            scope["pictures"], found.relight(np.array([[1.0] * 256, [0.0, 1.0] * 128]))
        )
        with pytest.raises(InputError, match=r"sample of that name.*train-08"):
            read_light_transport(path, "train-08")

    def test_another_file_is_one_line(self, folder, tmp_path):
        with pytest.raises(InputError, match=r"index\.parquet: expected the column sample_id"):
            read_light_transport(folder / "index.parquet")
        (tmp_path / "x.parquet").write_bytes(b"PAR1")
        with pytest.raises(InputError, match="expected a Parquet file of light transport"):
            read_light_transport(tmp_path / "x.parquet")

    def test_one_marginal_is_not_enough(self, folder, tmp_path):
        outcome = run_cli(
            *("dataset", "export", folder, "--out", tmp_path / "x", "--format", "light-transport")
        )
        check_refused(outcome, "marginals = ['uv'] of the specification")
        assert list(tmp_path.iterdir()) == []

    def test_patterns_have_no_part_in_it(self, data, tmp_path):
        with pytest.raises(InputError, match="--patterns: expected none"):
            export(data, tmp_path / "x", "light-transport", RECIPE)

    @pytest.mark.slow
    def test_a_data_set_that_was_made_for_it(self, tmp_path):
        """As the page says: marginals of the specification, then the command."""
        spec = write_spec(tmp_path, marginals=["uv"], patterns=None)
        out = tmp_path / "set"
        made = run_cli("dataset", "make", spec, "--out", out, "--count", 2, "--workers", 0)
        assert made.status == 0, made.err
        target = tmp_path / "x"
        outcome = run_cli("dataset", "export", out, "--out", target, "--format", "light-transport")
        assert outcome.status == 0, outcome.err
        (path,) = target.glob("*.parquet")
        assert read_light_transport(path, "000001")[2].any()


class TestFromEntries:
    def test_duplicates_are_summed_and_order_does_not_matter(self):
        light = LightTransport.from_entries([1, 0, 1], [5, 2, 5], [1.0, 2.0, 3.0], (1, 2), (3, 2))
        np.testing.assert_array_equal(light.relight_images(np.ones((1, 2, 3)))[0], [[2.0, 4.0]])
        np.testing.assert_array_equal(light.relight(np.eye(3))[:, 0], [[0, 0], [0, 0], [2, 4]])
        rows = light.relight(np.eye(2), along="v")[:, 0]
        np.testing.assert_array_equal(rows, [[2, 0], [0, 4]])

    def test_it_is_saved_and_loaded(self, tmp_path):
        light = LightTransport.from_entries([0], [3], [0.5], (2, 2), (2, 2), np.ones((2, 2)))
        light.save(tmp_path / "light.npz")
        again = LightTransport.load(tmp_path / "light.npz")
        panel = np.arange(4.0).reshape(1, 2, 2)
        np.testing.assert_array_equal(
            again.relight_images(panel), [[[1.0 + 0.5 * 3.0, 1.0], [1.0, 1.0]]]
        )

    @pytest.mark.parametrize(
        ("rows", "columns", "values", "word"),
        [
            ([4], [0], [1.0], "rows: expected pixels from 0 to 3"),
            ([-1], [0], [1.0], "rows"),
            ([0], [6], [1.0], "columns: expected pixels from 0 to 5"),
            ([0.5], [0], [1.0], "rows"),
            ([0, 1], [0], [1.0], "three arrays of one length"),
            ([0], [0], [np.nan], "finite"),
        ],
    )
    def test_entries_that_do_not_fit(self, rows, columns, values, word):
        with pytest.raises(InputError, match=word):
            LightTransport.from_entries(rows, columns, values, (2, 2), (3, 2))
