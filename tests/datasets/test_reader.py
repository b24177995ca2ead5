"""Reading a data set: lazily, by offset, checked; new patterns on stored light."""

import gc
import io
import json
import pickle
import shutil
import tarfile
from dataclasses import replace
from pathlib import Path

import datasets_small as small
import fsspec
import numpy as np
import pytest
from stages import capture

from slbench import datasets
from slbench.core.errors import InputError
from slbench.datasets.store.storage import Storage
from slbench.detector.emva1288 import Detector
from slbench.patterns import PatternSequence
from slbench.scene.model import Exposure
from slbench.simulate.scan import scan

READY = [n for n in range(small.COUNT) if n != small.FAILED]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return small.write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture
def copy(folder, tmp_path):
    return Path(shutil.copytree(folder, tmp_path / "copy"))


@pytest.fixture(scope="module")
def data(folder):
    return datasets.open_dataset(folder)


def shard(folder, number=0):
    return folder / "shards" / f"{number:06d}.tar"


def refusal(action):
    """Return the message of a refused sample, which is one line."""
    with pytest.raises(InputError) as caught:
        action()
    line = str(caught.value)
    assert "\n" not in line
    return line


class TestSequence:
    def test_length_order_and_negative_indices(self, data):
        assert len(data) == len(READY)
        assert [item.number for item in data] == READY
        assert data[-1].number == READY[-1]
        with pytest.raises(IndexError):
            data[len(data)]

    def test_slices_are_data_sets(self, data):
        part = data[1:6:2]
        assert [item.number for item in part] == READY[1:6:2]
        assert [item.number for item in part[1:]] == READY[3:6:2]

    def test_failed_samples_are_left_out_with_their_reason(self, data):
        assert [(row["sample"], row["reason"]) for row in data.failed] == [
            (small.FAILED, "no lit pixels")
        ]

    def test_columns(self, data):
        assert data.column("height_mm").tolist() == [small.height(n) for n in READY]
        assert set(data.column("kind")) == {"step_block"}
        assert "height_mm" in refusal(lambda: data.column("heigth_mm"))

    def test_a_sample_pickles(self, data):
        again = pickle.loads(pickle.dumps(data))[2]
        np.testing.assert_array_equal(again.frames, data[2].frames)

    def test_opening_reads_no_shard(self, copy):
        shutil.rmtree(copy / "shards")
        assert len(datasets.open_dataset(copy)) == len(READY)

    def test_a_sample_reads_its_own_range_alone(self, data, monkeypatch):
        ranges = []
        original = Storage.read_range

        def watched(storage, name, offset, size):
            ranges.append((name, offset, size))
            return original(storage, name, offset, size)

        monkeypatch.setattr(Storage, "read_range", watched)
        item = data[3]
        assert ranges == []
        assert item.transport.shape == item.truth.depth.shape == (48, 64)
        assert ranges == [(item.row["shard"], item.row["offset"], item.row["size"])]

    def test_any_file_system_of_fsspec(self, folder, data):
        memory = fsspec.filesystem("memory")
        memory.put(str(folder), "memory://reader-test", recursive=True)
        try:
            far = datasets.open_dataset("memory://reader-test")
            np.testing.assert_array_equal(far[5].frames, data[5].frames)
        finally:
            memory.rm("/reader-test", recursive=True)

    def test_working_ahead_keeps_the_order(self, data):
        for count in (1, 3, 100):
            assert [item.number for item in data.ahead(lambda x: x, count)] == READY

    def test_samples_made_ready_ahead_need_no_more_reading(self, data, monkeypatch):
        ready = list(data[:2].ahead(datasets.Sample.ready))
        wanted = [item.capture("1,8").frames for item in data[:2]]
        monkeypatch.setattr(Storage, "read_range", None)
        for item, frames in zip(ready, wanted, strict=True):
            np.testing.assert_array_equal(item.capture("1,8").frames, frames)

    def test_iterating_keeps_no_sample(self, data):
        for item in data[:3]:
            assert item.transport.shape == (48, 64)
        del item
        gc.collect()
        left = [x for x in gc.get_objects() if type(x) is datasets.Sample]
        assert [x for x in left if "transport" in vars(x)] == []


class TestParts:
    def test_they_are_what_the_scan_made(self, data):
        number = 6
        item, made = data[READY.index(number)], small.result_of(number)
        np.testing.assert_array_equal(item.transport.white(), made.transport.white())
        np.testing.assert_array_equal(item.frames, made.capture.frames)
        np.testing.assert_array_equal(item.truth.status, made.truth.status)
        # Single precision in EXR: 2^-24 of 800 mm is 5e-5 mm.
        np.testing.assert_allclose(item.truth.depth, made.truth.depth, atol=1e-4)
        np.testing.assert_allclose(item.rig.camera.matrix, made.scene.rig.camera.matrix, rtol=1e-12)
        assert item.scene.objects[0].artefact.parameters["heights_mm"] == (small.height(number),)
        assert item.score["captures"]["p0r0"]["points"] == made.score.points
        assert item.captures == ("p0r0",)
        assert item.stored("p0r0").sequence == made.scene.sequence
        assert item.seed == made.run.seed
        assert item.parameters == {
            "kind": "step_block",
            "height_mm": small.height(number),
            "ambient": small.ambient(number),
        }

    def test_truth_follows_from_what_is_stored(self, data):
        for number in range(len(data)):
            made = small.result_of(READY[number]).truth
            found = data[number].truth
            np.testing.assert_array_equal(found.object_id, made.object_id)
            # Heights below 32 mm are stored to 1e-6 mm, and rays lean by 45 degrees at most.
            np.testing.assert_allclose(found.point, made.point, rtol=0, atol=2e-6)
            np.testing.assert_allclose(found.depth, made.depth, rtol=0, atol=2e-6)
            np.testing.assert_allclose(found.normal, made.normal, rtol=0, atol=1e-7)
            # Some 10 px/mm at most.
            np.testing.assert_allclose(found.panel, made.panel, rtol=0, atol=2e-5)
            for name in ("camera_coc", "projector_coc"):
                np.testing.assert_allclose(getattr(found, name), getattr(made, name), atol=1e-6)

    def test_the_first_layout_is_read(self, data, tmp_path):
        """It held what follows too, in single precision."""
        old = datasets.open_dataset(small.write_dataset(tmp_path / "old", layout=1))
        assert old.manifest.format == 1
        for name in ("point", "depth", "panel"):
            first, second = (getattr(one[1].truth, name) for one in (old, data))
            # 2^-24 of 800 mm or px is 5e-5.
            np.testing.assert_allclose(first, second, rtol=0, atol=1e-4)
        np.testing.assert_array_equal(old[1].frames, data[1].frames)
        assert len(data[1].member("truth.exr")) < 0.4 * len(old[1].member("truth.exr"))

    @pytest.mark.parametrize("layout", [0, 4, "2", 2.0, True, None])
    def test_other_layouts_are_refused(self, layout, copy):
        path = copy / "dataset.json"
        values = json.loads(path.read_text())
        path.write_text(json.dumps({**values, "format": layout}))
        line = refusal(lambda: datasets.open_dataset(copy))
        assert f"dataset.json: format: expected 1, 2 or 3, got {layout!r}" in line

    def test_light_transport_alone(self, tmp_path):
        item = datasets.open_dataset(small.write_dataset(tmp_path / "bare", frames=False))[0]
        assert item.captures == ()
        assert "Sample.capture" in refusal(lambda: item.frames)
        assert item.capture("1,10").frames.shape == (6, 48, 64)


class TestCapture:
    def test_stored_frames_again(self, data):
        for item in data:
            again = item.capture(item.stored().sequence, seed=item.seed)
            np.testing.assert_array_equal(again.frames, item.frames)

    @pytest.mark.parametrize("number", [0, 3])
    def test_equals_a_fresh_scan(self, data, number):
        item = data[READY.index(number)]
        detector = Detector(bit_depth=12, read_noise_e=5.0, prnu=0.01, seed=7)
        scene = replace(item.scene.with_patterns("1,10,50@4"), detector=detector)
        fresh = scan(scene, seed=item.seed).capture
        mine = item.capture("1,10,50@4", detector, item.seed)
        np.testing.assert_array_equal(mine.frames, fresh.frames)
        assert mine.exposure_s == fresh.exposure_s
        assert mine.noise == fresh.noise

    def test_equals_exposing_the_traced_light_under_any_seed(self, data):
        number = 1
        item, made = data[READY.index(number)], small.result_of(number)
        for seed in (0, 5):
            for noise in (True, False):
                scene = made.scene.with_patterns("gray+16@8")
                wanted = capture(scene, made.transport, seed=seed, noise=noise).frames
                got = item.capture("gray+16@8", seed=seed, noise=noise).frames
                np.testing.assert_array_equal(got, wanted)

    def test_exposure_and_response_can_be_changed(self, data):
        item = data[0]
        dim = item.capture("white", noise=False, exposure=Exposure(white_level=0.4)).frames
        full = item.capture("white", noise=False).frames
        black = item._settings.detector.black_dn
        bright = full > 100
        ratio = (dim[bright] - black) / (full[bright] - black)
        # Both levels are rounded to a digital number of about 100.
        np.testing.assert_allclose(ratio, 0.5, atol=0.01)
        linear = item.capture("1@8", noise=False).frames.astype(float)
        bent = item.capture("1@8", noise=False, gamma=2.2).frames.astype(float)
        assert bent.mean() < 0.95 * linear.mean()

    def test_sequences_and_texts_are_the_same(self, data):
        item = data[2]
        sequence = PatternSequence.parse("1,16@8", item.transport.panel)
        np.testing.assert_array_equal(item.capture(sequence).frames, item.capture("1,16@8").frames)

    @pytest.mark.parametrize("text", ["", "1,x", "400"])
    def test_patterns_that_cannot_be_shown(self, data, text):
        assert "patterns" in refusal(lambda: data[0].capture(text))

    def test_axes_that_are_not_stored(self, data):
        sequence = PatternSequence.parse("1,8", data[0].transport.panel, axes="v")
        assert "'v' marginal" in refusal(lambda: data[0].capture(sequence))

    @pytest.mark.parametrize("patterns", [5, None, ["1,8"]])
    def test_patterns_of_another_kind(self, data, patterns):
        assert "patterns: expected a PatternSequence" in refusal(lambda: data[0].capture(patterns))

    @pytest.mark.parametrize("seed", [-1, 1.5, True, "1"])
    def test_bad_seeds(self, data, seed):
        assert "seed: expected a whole number" in refusal(lambda: data[0].capture("1", seed=seed))
        with pytest.raises(InputError, match="seed: expected a whole number"):
            data.split(train=0.5, test=0.5, seed=seed)

    def test_numpys_whole_numbers_are_seeds(self, data):
        seed = np.int64(3)
        wanted = data[0].capture("1", seed=3).frames
        np.testing.assert_array_equal(data[0].capture("1", seed=seed).frames, wanted)
        assert data.split(a=0.5, seed=seed)["a"].rows == data.split(a=0.5, seed=3)["a"].rows

    def test_the_objects_are_not_built(self, data, monkeypatch):
        # Their meshes cost more than the frames.
        monkeypatch.setattr("slbench.objects.build_artefact", None)
        assert data[0].capture("1,8").frames.shape == (6, 48, 64)


class TestDamage:
    def spoilt(self, copy, change, number=0):
        path = shard(copy, number)
        path.write_bytes(change(path.read_bytes()))
        return datasets.open_dataset(copy)

    def test_a_flipped_byte_spoils_its_sample_alone(self, copy, data):
        row = data[2].row

        def flip(content):
            place = row["offset"] + row["size"] // 2
            return content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]

        broken = self.spoilt(copy, flip)
        line = refusal(lambda: broken[2].transport)
        assert f"shards/000000.tar: sample {row['key']}" in line
        assert row["sha256"] in line
        for k in set(range(len(data))) - {2}:
            np.testing.assert_array_equal(broken[k].frames, data[k].frames)

    def test_every_byte_counts(self, copy, data):
        # Headers and padding too; 40 places spread over the sample.
        row = data[1].row
        original = shard(copy).read_bytes()
        for place in np.linspace(0, row["size"] - 1, 40).astype(int):
            content = bytearray(original)
            content[row["offset"] + place] ^= 0x10
            shard(copy).write_bytes(bytes(content))
            assert "SHA-256" in refusal(lambda: datasets.open_dataset(copy)[1].members)

    def test_without_the_check_a_damaged_file_is_still_one_line(self, copy, data):
        row = data[0].row
        with tarfile.open(shard(copy)) as archive:
            place = archive.getmember(f"{row['key']}.transport.npz").offset_data
        content = bytearray(shard(copy).read_bytes())
        content[place + 2000] ^= 0xFF
        shard(copy).write_bytes(bytes(content))
        item = datasets.open_dataset(copy, verify=False)[0]
        line = refusal(lambda: item.transport)
        assert "sample 000000: transport.npz" in line
        assert "/slbench-sample-" not in line.split(": expected")[0]

    def test_a_truncated_shard(self, copy, data):
        last = data[3].row  # of the first shard
        broken = self.spoilt(copy, lambda content: content[: last["offset"] + 700])
        line = refusal(lambda: broken[3].transport)
        assert "000003" in line
        assert f"{last['size']} bytes" in line
        assert "700" in line
        for k in (0, 1, 2, 4, 7):
            np.testing.assert_array_equal(broken[k].frames, data[k].frames)

    def test_a_missing_shard(self, copy, data):
        shard(copy, 1).unlink()
        broken = datasets.open_dataset(copy)
        assert "000001.tar" in refusal(lambda: broken[-1].frames)
        np.testing.assert_array_equal(broken[0].frames, data[0].frames)

    def test_a_sample_in_anothers_place(self, copy, data):
        # Same size and place in the index, other contents: the key would be wrong too.
        other = datasets.open_dataset(copy, verify=False)
        swapped = replace(other[1], row=other[1].row | {"offset": data[2].row["offset"]})
        assert "sample 000001" in refusal(lambda: swapped.members)

    def test_no_index(self, copy):
        (copy / "index.parquet").unlink()
        line = refusal(lambda: datasets.open_dataset(copy))
        assert "index.parquet" in line
        assert "--resume" in line

    def test_a_damaged_index(self, copy):
        path = copy / "index.parquet"
        path.write_bytes(path.read_bytes()[:-20])
        assert "index.parquet" in refusal(lambda: datasets.open_dataset(copy))

    @pytest.mark.parametrize(
        "change",
        [
            {"shard": "../outside.tar"},
            {"shard": None},
            {"offset": -5},
            {"size": 0},
            {"key": "../../by-key"},
            {"key": "000001"},
            {"object": None},
            {"status": "maybe"},
        ],
        ids=str,
    )
    def test_an_index_that_points_elsewhere(self, copy, change):
        from slbench.datasets.manifest import Manifest
        from slbench.datasets.store import index

        storage = Storage(str(copy))
        rows = index.decode(storage.read(index.INDEX), "index")
        rows[0] |= change
        storage.write(index.INDEX, index.encode(rows, Manifest.load(storage).columns))
        assert "sample 0" in refusal(lambda: datasets.open_dataset(copy))

    def test_more_bytes_than_there_are_are_not_asked_for(self, data):
        row = data[0].row | {"size": 2**62}
        assert "the shard ends there" in refusal(lambda: replace(data[0], row=row).members)

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda table: table.drop_columns(["height_mm"]), "no column"),
            (lambda table: table.drop_columns(["offset"]), "no column"),
            (lambda table: table.append_column("more", table["key"]), "'more'"),
            (lambda table: table.append_column("key", table["key"]), "2 column"),
            (lambda table: table.set_column(0, "sample", table["key"]), "sample of int64"),
            (
                lambda table: table.drop_columns(["height_mm"]).append_column(
                    "height_mm", table["key"]
                ),
                "height_mm of double, got string",
            ),
        ],
    )
    def test_columns_are_those_of_the_manifest(self, copy, change, words):
        parquet = pytest.importorskip("pyarrow.parquet")
        path = copy / "index.parquet"
        parquet.write_table(change(parquet.read_table(path)), path)
        assert words in refusal(lambda: datasets.open_dataset(copy))

    @pytest.mark.parametrize("kind", ["missing", "empty", "file"])
    def test_no_data_set(self, tmp_path, kind):
        path = tmp_path / "x"
        if kind == "empty":
            path.mkdir()
        elif kind == "file":
            path.write_text("not a data set")
        assert str(path) in refusal(lambda: datasets.open_dataset(path))


class TestWhere:
    @pytest.mark.parametrize(
        ("expression", "wanted"),
        [
            ("height_mm > 3.5", lambda h, a: h > 3.5),
            ("height_mm >= 3 and ambient == 0.5", lambda h, a: h >= 3 and a == 0.5),
            ("not (height_mm < 3 or ambient > 0)", lambda h, a: not (h < 3 or a > 0)),
            ("height_mm in (2, 5.0)", lambda h, a: h in (2, 5)),
            ("height_mm not in [2, 5.0]", lambda h, a: h not in (2, 5)),
            ("2 < height_mm <= 4", lambda h, a: 2 < h <= 4),
            ("kind == 'step_block' and -1 < ambient", lambda h, a: True),
            ("kind != 'step_block'", lambda h, a: False),
            ("ambient < height_mm and height_mm < 2.5", lambda h, a: h < 2.5),
        ],
    )
    def test_selects_as_python_does(self, data, expression, wanted):
        kept = [n for n in READY if wanted(small.height(n), small.ambient(n))]
        assert [item.number for item in data.where(expression)] == kept

    def test_a_missing_value_is_never_selected(self, data):
        rows = [dict(row) for row in data.rows]
        for row in rows[:2]:
            row["height_mm"] = None
        some = replace(data, rows=tuple(rows))
        above = some.where("height_mm > 3")
        below = some.where("not height_mm > 3")
        assert len(above) + len(below) == len(data) - 2
        # Where the rest decides, it does not matter.
        assert len(some.where("height_mm > 3 or kind == 'step_block'")) == len(data)
        assert len(some.where("height_mm > 3 and kind == 'coin'")) == 0

    @pytest.mark.parametrize(
        "expression",
        [
            "",
            "height_mm",
            "height_mm >",
            "height_mm > 'a'",
            "kind > 3",
            "height_mm in 3",
            "height_mm in ()",
            "height_mm in (1, 'a')",
            "height_mm == (1, 2)",
            "height_mm + 1 > 2",
            "height_mm is 3",
            "__import__('os').system('true') == 0",
            "[x for x in (1, 2)] == 1",
            "kind.upper() == 'GEAR'",
            "(lambda: 1)() == 1",
            "f'{kind}' == 'gear'",
            "height_mm > 1; ambient > 1",
            "height_mm := 1",
            "1 < 2j",
            "height_mm > None",
            "-kind == 'a'",
            "(" * 300 + "height_mm > 1" + ")" * 300,
            "not " * 300 + "height_mm > 1",
            "height_mm > 1 or " * 200 + "ambient > 1",
            "height_mm > 1\x00",
        ],
    )
    def test_nothing_else_is_read(self, data, expression):
        assert "--where" in refusal(lambda: data.where(expression))

    def test_an_unknown_column_lists_the_columns(self, data):
        line = refusal(lambda: data.where("heigth_mm > 1"))
        assert "'heigth_mm'" in line
        assert "height_mm, ambient" in line


class TestSplit:
    def objects(self, data):
        return {row["object"] for row in data.rows}

    def test_no_object_in_two_parts(self, data):
        for seed in range(20):
            parts = data.split(train=0.5, test=0.5, seed=seed)
            assert self.objects(parts["train"]).isdisjoint(self.objects(parts["test"]))
            both = [item.number for part in parts.values() for item in part]
            assert sorted(both) == READY

    def test_the_seed_decides(self, data):
        def chosen(seed):
            return frozenset(x.number for x in data.split(train=0.75, test=0.25, seed=seed)["test"])

        assert chosen(3) == chosen(3)
        assert len({chosen(seed) for seed in range(20)}) > 1

    def test_fractions_are_kept_and_the_rest_left_out(self):
        from slbench.datasets.read.split import by_object

        objects = [f"{k % 137}" for k in range(1000)]
        parts = by_object(objects, {"train": 0.6, "test": 0.2}, seed=1)
        # An object has seven or eight of the samples.
        assert abs(len(parts["train"]) - 600) <= 8
        assert abs(len(parts["test"]) - 200) <= 8
        assert parts["train"] == sorted(parts["train"])

    def test_the_order_of_samples_does_not_matter(self):
        from slbench.datasets.read.split import by_object

        objects = [f"{k % 7}" for k in range(70)]
        one = by_object(objects, {"a": 0.5, "b": 0.5}, seed=4)
        two = by_object(objects[::-1], {"a": 0.5, "b": 0.5}, seed=4)
        assert {objects[k] for k in one["a"]} == {objects[::-1][k] for k in two["a"]}

    @pytest.mark.parametrize(
        "fractions",
        [
            {},
            {"train": 0.8, "test": 0.3},
            {"train": 0.0},
            {"train": -0.5},
            {"train": float("nan")},
            {"train": True},
            {"train": "all"},
            {f"part{k}": 0.1 for k in range(10)},  # of four objects
        ],
    )
    def test_impossible_fractions(self, data, fractions):
        said = refusal(lambda: data.split(**fractions))
        assert said.startswith(("split", "fractions.train: "))


def test_a_shard_is_a_plain_tar(folder):
    with tarfile.open(fileobj=io.BytesIO(shard(folder).read_bytes())) as archive:
        names = archive.getnames()
    assert "000000.transport.npz" in names
