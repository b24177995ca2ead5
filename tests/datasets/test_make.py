"""Making data sets: the same bytes however they are made; failures; damage is named."""

import io
import json
import platform
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import numpy as np
import pytest
from dataset_specs import hashes, rows_of, write_spec
from scenes_small import small, transport_of, truth_of
from stages import floor_rms_px, noise_free_coordinates

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.datasets.make import tasks
from slbench.datasets.make.cluster import LostError, local_cluster
from slbench.datasets.make.engine import _running, check_request, make_dataset
from slbench.datasets.make.sample_maker import environment, make_sample, row_of
from slbench.datasets.manifest import Manifest
from slbench.datasets.read.reader import open_dataset
from slbench.datasets.spec.sampling import draw
from slbench.datasets.spec.specification import load
from slbench.datasets.store import index
from slbench.datasets.store import sample as sample_files
from slbench.datasets.store.sample import EXACT_BITS, rounded, unpacked, write_transport
from slbench.datasets.store.shards import END, digest, key, pack, unpack
from slbench.datasets.store.storage import Storage, is_temporary
from slbench.datasets.verify import information, verify_dataset
from slbench.scene.file import load_scene
from slbench.simulate.scan import scan
from slbench.simulate.transport import LightTransport

COUNT, SEED = 5, 3


@pytest.fixture(scope="module")
def cluster():
    with local_cluster(0) as running:
        yield running


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return load(write_spec(tmp_path_factory.mktemp("spec")))


@pytest.fixture(scope="module")
def made(tiny, cluster, tmp_path_factory):
    """A data set of five samples in three shards."""
    url = str(tmp_path_factory.mktemp("data") / "set")
    result = make_dataset(*tiny, url, COUNT, cluster, seed=SEED)
    assert result.failed == 0
    assert result.made == COUNT
    return url


@pytest.fixture
def copy(made, tmp_path):
    shutil.copytree(made, tmp_path / "copy")
    return tmp_path / "copy"


def flipped(content, where=1000):
    content = bytearray(content)
    content[where] ^= 1
    return bytes(content)


def flip(path, where):
    path.write_bytes(flipped(path.read_bytes(), where))


def members_of(url, row):
    content = Storage(str(url)).read_range(row["shard"], row["offset"], row["size"])
    return sample_files.unpack(row["sample"], content, "sample")


class TestShards:
    def test_entries_follow_from_key_and_members_alone(self):
        members = {"b.json": b"2" * 700, "a.toml": b"1"}
        content = pack(7, members)
        assert content == pack(7, dict(reversed(members.items())))
        assert len(content) % 512 == 0
        assert unpack(7, content, "here") == members

    def test_any_tar_reader_reads_a_shard(self, made):
        with tarfile.open(f"{made}/shards/000001.tar") as archive:
            entries = archive.getmembers()
        assert {entry.name.split(".")[0] for entry in entries} == {"000002", "000003"}
        assert {(e.mtime, e.uid, e.gid, e.uname) for e in entries} == {(0, 0, 0, "")}

    @pytest.mark.parametrize("name", ["plain", "a/b.c", "../x.y", ".hidden", "a..b"])
    def test_names_that_would_not_come_back_are_refused(self, name):
        with pytest.raises(InputError, match="member"):
            pack(0, {name: b""})

    @pytest.mark.parametrize("name", ["../../x.y", "/abs/x.y", "a/b.c", "x", "..", "a.b\n"])
    def test_names_that_pack_refuses_are_not_unpacked(self, name):
        # A foreign data set's: they would be written to wherever they say.
        stream = io.BytesIO()
        with tarfile.open(fileobj=stream, mode="w") as archive:
            archive.addfile(tarfile.TarInfo(f"000000.{name}"), io.BytesIO())
        with pytest.raises(InputError, match="here: expected files of sample 000000"):
            unpack(0, stream.getvalue(), "here")

    def test_a_size_beyond_all_memory_is_damage(self):
        content = bytearray(pack(0, {"a.b": b"x"}))
        content[124:136] = b"\xff" + b"\x7f" * 11  # tar's form for sizes of more than 8 GB
        content[148:156] = b" " * 8
        content[148:156] = b"%06o\0 " % sum(content[:512])
        with pytest.raises(InputError, match="here: expected"):
            unpack(0, bytes(content), "here")

    def test_meshes_of_long_names_fit_into_a_tar(self, tmp_path):
        # USTAR has 100 bytes for a name.
        names = [f"{'long-' * 30}{letter}.stl" for letter in "ab"]
        for name in names:
            (tmp_path / name).write_text(f"solid {name}\nendsolid\n")
        objects = [{"name": name[-5], "mesh": name, "unit": "mm"} for name in names]
        files = load(write_spec(tmp_path, objects=objects))[1]
        assert len(files) == 2  # they stay distinct
        assert unpack(12345678, pack(12345678, files), "here") == files

    def test_keys_outgrow_six_digits(self):
        assert key(12) == "000012"
        assert unpack(12345678, pack(12345678, {"a.b": b"x"}), "here") == {"a.b": b"x"}


class TestSameBytes:
    def test_a_sample_made_alone_is_the_one_in_the_shard(self, tiny, made):
        # In another thread, in another order, without what the others left behind.
        for sample in (4, 1):
            members = make_sample(*tiny, SEED, sample)
            assert digest(sample_files.pack(sample, members)) == hashes(made)[sample]

    def test_another_place_has_the_same_samples(self, tiny, made, cluster):
        url = "memory://tiny-elsewhere"
        make_dataset(*tiny, url, 3, cluster, seed=SEED)
        assert hashes(url) == hashes(made)[:3]
        assert verify_dataset(url) == ([], {**verify_dataset(url)[1], "samples": 3})

    def test_nothing_in_a_sample_tells_time_machine_or_place(self, made):
        # A host's name may be a word that stands anywhere.
        words = {f'"{platform.node()}"', made, "/tmp", "time_utc", "seconds"}
        for row in rows_of(made):
            for name, content in members_of(made, row).items():
                for word in words:
                    assert word.encode() not in content, name

    def test_the_index_follows_from_the_shards(self, made):
        for row in rows_of(made):
            own = row_of(row["sample"], members_of(made, row))
            for name, value in own.items():
                assert row[name] == (None if value != value else value)

    def test_the_row_says_what_was_drawn(self, tiny, made):
        for row in rows_of(made):
            drawn = draw(tiny[0], SEED, row["sample"], row["draws"] - 1)
            assert row["kind"] == drawn.kind
            assert drawn.values.items() <= row.items()


class TestFrames:
    def test_stored_frames_are_those_of_a_fresh_scan(self, made):
        row = rows_of(made)[0]
        with unpacked(members_of(made, row)) as folder:
            stored = Capture.load(folder / "p0r0.capture.toml")
            scene = load_scene(folder / "scene.toml").with_patterns("1,10")
            transport = LightTransport.load(folder / "transport.npz")
            other = Capture.load(folder / "p0r1.capture.toml")
        fresh = scan(scene, seed=row["seed"])
        np.testing.assert_array_equal(stored.frames, fresh.capture.frames)
        np.testing.assert_array_equal(
            transport.marginals["u"].data, fresh.transport.marginals["u"].data
        )
        assert row["p0r0_rms_mm"] == fresh.score.rms_mm
        # The repeat shows the same light with noise of its own.
        assert 0 < np.mean(stored.frames != other.frames) < 1
        assert abs(stored.frames.mean() - other.frames.mean()) < 0.1

    def test_rounded_weights_stay_below_the_renderers_floor(self, tmp_path):
        # Weights of 10 bits are off by 2**-11 at most, and so is every picture; the panel
        # coordinate moves by less than a tenth of what it is off by anyway.
        scene, exact, truth = (
            small("step-block"),
            transport_of("step-block"),
            truth_of("step-block"),
        )
        sizes = {}
        for bits in (EXACT_BITS, 10):
            write_transport(tmp_path / f"{bits}.npz", rounded(exact, bits))
            sizes[bits] = (tmp_path / f"{bits}.npz").stat().st_size
        stored = LightTransport.load(tmp_path / "10.npz")
        fringes = scene.sequence.profiles("u")[1]
        # Beside rounding, sums of float32.
        np.testing.assert_allclose(
            stored.relight(fringes), exact.relight(fringes), rtol=2.0**-11 + 1e-5
        )
        panel = [noise_free_coordinates(scene, t)["u"] for t in (exact, stored)]
        change = np.sqrt(np.mean((panel[1] - panel[0])[truth.smooth()] ** 2))
        assert 0.0 < change < 0.1 * floor_rms_px(scene, exact, truth)
        assert sizes[10] < 0.8 * sizes[EXACT_BITS]

    def test_all_bits_are_the_traced_weights(self, tmp_path):
        exact = transport_of("step-block")
        write_transport(tmp_path / "exact.npz", exact)
        stored = LightTransport.load(tmp_path / "exact.npz").marginals["u"]
        np.testing.assert_array_equal(stored.data, exact.marginals["u"].data)
        np.testing.assert_array_equal(stored.indices, exact.marginals["u"].indices)

    def test_transport_alone(self, tmp_path):
        spec, files = load(write_spec(tmp_path, patterns=None, marginals=["v", "uv"]))
        members = make_sample(spec, files, 0, 0)
        assert not any("frame" in name or "capture" in name for name in members)
        with unpacked(members) as folder:
            assert set(LightTransport.load(folder / "transport.npz").marginals) == {"v", "uv"}
        assert json.loads(members["score.json"])["captures"] == {}


class TestFailures:
    def test_a_failing_sample_is_tried_again_then_recorded(
        self, tiny, made, cluster, tmp_path, monkeypatch
    ):
        calls = []

        def broken(specification, files, seed, sample, **options):
            calls.append(sample)
            if sample == 1 or (sample == 3 and calls.count(3) < 2):
                raise RuntimeError("no light\ntoday")
            return make_sample(specification, files, seed, sample, **options)

        monkeypatch.setattr(tasks, "make_sample", broken)
        url = str(tmp_path / "set")
        result = make_dataset(*tiny, url, COUNT, cluster, seed=SEED)
        rows = rows_of(url)
        assert result.failed == 1
        assert calls.count(1) == tasks.ATTEMPTS
        assert (rows[1]["status"], rows[1]["attempts"]) == ("failed", tasks.ATTEMPTS)
        assert rows[1]["reason"] == "RuntimeError: no light today"
        assert rows[1]["sha256"] is None
        assert (rows[3]["status"], rows[3]["attempts"]) == ("ok", 2)
        assert verify_dataset(url)[0] == []
        assert information(url)["failed"] == {"000001": rows[1]["reason"]}

        # The cause removed, another run gives it another try and leaves the others alone.
        monkeypatch.undo()
        resumed = make_dataset(*tiny, url, COUNT, cluster, seed=SEED, resume=True)
        assert (resumed.made, resumed.failed) == (1, 0)
        assert hashes(url) == hashes(made)
        assert verify_dataset(url)[0] == []

    def test_what_meets_no_constraint_fails_at_once(self, cluster, tmp_path):
        limits = {"min_lit_share": 1.0, "max_draws": 2}
        spec, files = load(write_spec(tmp_path, constraints=limits))
        result = make_dataset(spec, files, str(tmp_path / "set"), 1, cluster)
        (row,) = rows_of(tmp_path / "set")
        assert result.failed == 1
        assert row["attempts"] == 1
        assert "none of 2 draws" in row["reason"]
        assert "too few lit pixels" in row["reason"]


def begun(folder):
    """Begin a run of a data set, as the engine does."""
    storage = Storage(str(folder))
    storage.write(tasks.RUN, b'{"token": "own"}')
    return tasks.Run(str(folder), "own", digest(storage.read("dataset.json")))


class TestResume:
    def test_whatever_a_kill_leaves_is_finished(self, tiny, made, copy, cluster):
        # As if killed: while one shard was being made, another packed but without its rows,
        # a temporary file half written, the index not there.
        storage = Storage(str(copy))
        rows = rows_of(copy)
        content = storage.read_range(rows[0]["shard"], rows[0]["offset"], rows[0]["size"])
        tasks.stage(begun(copy), 0, content)
        (copy / "shards" / "000000.tar").unlink()
        (copy / "shards" / "000000.parquet").unlink()
        (copy / "shards" / "000001.parquet").unlink()
        (copy / "shards" / ".000001.0123456789ab.tar").write_bytes(b"half")
        (copy / "index.parquet").unlink()
        storage.write("run.json", b'{"token": "of a killed run"}')
        result = make_dataset(*tiny, str(copy), COUNT, cluster, seed=SEED, resume=True)
        assert (result.made, result.kept) == (3, 2)  # the staged one, and the third shard's
        assert hashes(copy) == hashes(made)
        assert verify_dataset(str(copy))[0] == []
        assert sorted(p.name for p in (copy / "shards").iterdir()) == sorted(
            p.name for p in (Storage(made).local / "shards").iterdir()
        )

    @pytest.mark.parametrize(
        "spoil",
        [lambda c: b"", lambda c: c[:100], lambda c: c[:-1], flipped],
        ids=["empty", "a start", "all but a byte", "a flipped bit"],
    )
    def test_a_damaged_staged_sample_is_made_again(self, spoil, tiny, made, copy, cluster):
        # Sample 4 is alone in the third shard.
        shard = copy / "shards" / "000002"
        row = rows_of(copy)[4]
        content = Storage(made).read_range(row["shard"], row["offset"], row["size"])
        run = begun(copy)
        tasks.stage(run, 4, content)
        assert tasks.staged(run.storage, 4) == content
        staged = copy / "staging" / "000004.tar"
        staged.write_bytes(spoil(staged.read_bytes()))
        shard.with_suffix(".tar").unlink()
        shard.with_suffix(".parquet").unlink()
        result = make_dataset(*tiny, str(copy), COUNT, cluster, seed=SEED, resume=True)
        assert (result.made, result.failed) == (1, 0)
        assert hashes(copy) == hashes(made)
        assert verify_dataset(str(copy))[0] == []

    def test_a_sample_that_is_spoilt_after_it_was_staged_is_not_packed(self, copy):
        run = begun(copy)
        row = rows_of(copy)[4]
        content = run.storage.read_range(row["shard"], row["offset"], row["size"])
        tasks.stage(run, 4, content)
        flip(copy / "staging" / "000004.tar", 1000)
        (copy / "shards" / "000002.parquet").unlink()
        with pytest.raises(InputError, match=r"staging/000004\.tar.*--resume"):
            tasks.pack_shard(run, 2, [row])
        assert not (copy / "shards" / "000002.parquet").exists()

    def test_only_what_it_wrote_is_removed(self, tiny, copy, cluster):
        mine = ["staging/thesis.txt", "card/.keep", ".gitattributes", "shards/.nfs000123", ".git/x"]
        for name in mine:
            (copy / name).parent.mkdir(exist_ok=True)
            (copy / name).write_text("mine")
        storage = Storage(str(copy))
        storage.write("staging/000003.tar", b"")
        left = ["shards/.000001.0123456789ab.tar", ".dataset.0123456789ab.json"]
        left.append("staging/.writing-0123456789ab-000001.tar")
        for name in left:
            (copy / name).write_bytes(b"half")
        (copy / "shards/.000001.0123456789ab.slbench").mkdir()
        (copy / "shards/.000001.0123456789ab.slbench/000001.tar").write_bytes(b"half")
        left.append("shards/.000001.0123456789ab.slbench")
        make_dataset(*tiny, str(copy), COUNT, cluster, seed=SEED, resume=True)
        assert [(copy / name).read_text() for name in mine] == ["mine"] * len(mine)
        assert not any((copy / name).exists() for name in (*left, "staging/000003.tar"))

    @pytest.mark.parametrize("local", [True, False])
    def test_unfinished_files_are_known_by_their_names(self, local, tmp_path, monkeypatch):
        # As they are called in the middle of writing, on a disk and on others without rename.
        storage = Storage(str(tmp_path / "set"))
        if not local:
            monkeypatch.setattr(Storage, "local", None)
        for name in ("dataset.json", "README.md", "shards/000000.tar", "files/mesh.a.stl"):
            with storage.writing(name):
                folder = tmp_path / "set" / Path(name).parent
                unfinished = [p.name for p in folder.iterdir() if p.name[0] == "."]
                assert len(unfinished) == 1
                assert is_temporary(unfinished[0])
            assert not is_temporary(Path(name).name)

    def test_a_kill_before_the_manifest_is_resumed(self, tiny, tmp_path):
        place = tmp_path / "set"
        place.mkdir()
        (place / ".dataset.0123456789ab.json").write_text("{")
        with pytest.raises(InputError, match="--resume"):
            check_request(*tiny, str(place), seed=SEED)
        check_request(*tiny, str(place), seed=SEED, resume=True)

    def test_a_folder_makes_a_place_not_empty(self, tiny, tmp_path):
        (tmp_path / "staging").mkdir()
        with pytest.raises(InputError, match=r"expected an empty place.*got folders"):
            check_request(*tiny, str(tmp_path), seed=SEED)
        with pytest.raises(InputError, match="other files"):
            check_request(*tiny, str(tmp_path), seed=SEED, resume=True)

    def test_the_second_of_two_fresh_runs_is_refused(self, tiny, made, monkeypatch, cluster):
        # Both found the place empty before either had written to it.
        monkeypatch.setattr(
            "slbench.datasets.make.engine.check_request", lambda *args, **more: None
        )
        with pytest.raises(InputError, match="another run has begun"):
            make_dataset(*tiny, made, COUNT, cluster, seed=SEED)
        assert not Path(made, "run.json").exists()

    def test_a_superseded_packer_puts_nothing_in_place(self, copy, monkeypatch):
        # It is taken over while it writes the shard.
        run = begun(copy)
        row = rows_of(copy)[4]
        content = run.storage.read_range(row["shard"], row["offset"], row["size"])
        tasks.stage(run, 4, content)
        for suffix in ("tar", "parquet"):
            (copy / "shards" / f"000002.{suffix}").unlink()
        staged = tasks.staged

        def slowly(storage, sample):
            storage.write(tasks.RUN, b'{"token": "of another run"}')
            return staged(storage, sample)

        monkeypatch.setattr(tasks, "staged", slowly)
        with pytest.raises(tasks.SupersededError, match="taken over"):
            tasks.pack_shard(run, 2, [row])
        assert [p.name for p in (copy / "shards").iterdir() if "000002" in p.name] == []

    def test_a_run_that_another_has_overtaken_says_so(self, copy):
        # The other has ended too, so that run.json is gone.
        def overtaken():
            with _running(Storage(str(copy))) as run:
                (copy / "run.json").unlink()
                run.check()

        with pytest.raises(tasks.SupersededError, match="ended"):
            overtaken()

    def test_a_truncated_shard_is_made_again(self, tiny, made, copy, cluster):
        shard = copy / "shards" / "000002.tar"
        shard.write_bytes(shard.read_bytes()[:1000])
        make_dataset(*tiny, str(copy), COUNT, cluster, seed=SEED, resume=True)
        assert hashes(copy) == hashes(made)
        assert verify_dataset(str(copy))[0] == []

    def test_a_worker_that_outlived_its_run_writes_nothing(self, made, copy):
        old = tasks.Run(str(copy), "of a killed run", digest(Storage(made).read("dataset.json")))
        with pytest.raises(tasks.SupersededError, match="ended"):
            tasks.make(old, 2)
        Storage(str(copy)).write("run.json", b'{"token": "of another run"}')
        with pytest.raises(tasks.SupersededError, match="taken over"):
            tasks.make(old, 2)
        assert not (copy / "staging").exists()

    @pytest.mark.parametrize(
        ("changes", "options", "words"),
        [
            ({}, {"seed": 4}, "seed"),
            ({}, {"count": 4}, "count"),
            ({}, {"preview": True}, "preview"),
            ({"licence": "another"}, {}, "licence"),
            ({"constraints": {"min_lit_share": 0.1}}, {}, r"specification\.constraints\..*"),
            ({"constraints": {"min_lit_share": 0.1}}, {"count": 9}, r"specification\..*"),
        ],
    )
    def test_another_data_set_is_not_finished_here(
        self, changes, options, words, made, cluster, tmp_path
    ):
        spec, files = load(write_spec(tmp_path, **changes))
        asked = {"count": COUNT, "seed": SEED} | options
        count = asked.pop("count")
        with pytest.raises(
            InputError, match=f"{words}: expected .*, which the data set was begun with"
        ):
            make_dataset(spec, files, made, count, cluster, resume=True, **asked)
        assert Manifest.load(Storage(made)).count == COUNT

    def test_other_versions_do_not_finish_it(self, tiny, copy, cluster):
        manifest = json.loads((copy / "dataset.json").read_text())
        manifest["environment"]["libraries"]["numpy"] = "1.0"
        (copy / "dataset.json").write_text(json.dumps(manifest))
        with pytest.raises(InputError, match=r"numpy 1\.0.*got 2"):
            make_dataset(*tiny, str(copy), COUNT, cluster, seed=SEED, resume=True)

    def test_a_place_that_holds_something_is_refused(self, tiny, made, cluster, tmp_path):
        with pytest.raises(InputError, match="--resume"):
            make_dataset(*tiny, made, COUNT, cluster, seed=SEED)
        (tmp_path / "letter.txt").write_text("Dear ...")
        with pytest.raises(InputError, match="other files"):
            make_dataset(*tiny, str(tmp_path), COUNT, cluster, resume=True)


def contents(folder):
    """Return all files of a data set but its card, by name."""
    paths = [path for path in Path(folder).rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.fixture(scope="module")
def three_samples(tiny, cluster, tmp_path_factory):
    """The first three samples of the five: a shard of two, and one that is half full."""
    url = str(tmp_path_factory.mktemp("three") / "set")
    make_dataset(*tiny, url, 3, cluster, seed=SEED)
    return url


class TestGrowth:
    @pytest.fixture
    def young(self, three_samples, tmp_path):
        shutil.copytree(three_samples, tmp_path / "young")
        return tmp_path / "young"

    def grown(self, tiny, young, cluster):
        result = make_dataset(*tiny, str(young), COUNT, cluster, seed=SEED, resume=True)
        assert result.made + result.kept == COUNT
        return result

    def test_it_is_the_data_set_that_is_made_at_once(self, tiny, made, young, cluster):
        assert contents(young) != contents(made)
        result = self.grown(tiny, young, cluster)
        assert (result.made, result.kept) == (2, 3)
        assert contents(young) == contents(made)

    @pytest.mark.parametrize("when", ["begun", "staged", "reopened", "made", "packed"])
    def test_growth_that_was_killed_is_finished(self, when, tiny, made, young, cluster):
        storage, whole = Storage(str(young)), Storage(made)
        storage.write("dataset.json", whole.read("dataset.json"))
        storage.write("run.json", b'{"token": "of a killed run"}')
        run = tasks.Run(str(young), "of a killed run", digest(storage.read("dataset.json")))
        rows = rows_of(young)
        half = [row for row in rows if row["sample"] == 2]
        content = storage.read_range(half[0]["shard"], half[0]["offset"], half[0]["size"])
        if when == "staged":
            tasks.stage(run, 2, content)
        elif when != "begun":
            assert tasks.reopen_shard(run, 1, half) == half
            assert not (young / "shards" / "000001.parquet").exists()
        if when in ("made", "packed"):
            assert tasks.make(run, 3)[1]
        if when == "packed":  # killed between the shard and its rows
            storage.write("shards/000001.tar", whole.read("shards/000001.tar"))
        assert verify_dataset(str(young))[0] != []
        assert self.grown(tiny, young, cluster).kept == 3 + (when in ("made", "packed"))
        assert contents(young) == contents(made)

    def test_a_damaged_sample_of_the_last_shard_is_made_again(self, tiny, made, young, cluster):
        flip(young / "shards" / "000001.tar", 5000)
        assert self.grown(tiny, young, cluster).made == 3
        assert contents(young) == contents(made)

    def test_it_is_read_while_it_grows(self, tiny, made, young, cluster):
        # The larger shard is there, the index is the old one.
        Storage(str(young)).write("dataset.json", Storage(made).read("dataset.json"))
        Storage(str(young)).write("shards/000001.tar", Storage(made).read("shards/000001.tar"))
        for old, new in zip(open_dataset(young), open_dataset(made), strict=False):
            assert old.members == new.members

    def test_a_row_keeps_its_attempts(self, tiny, young, cluster, monkeypatch):
        # Sample 2 needed a second attempt.
        rows = [row | {"attempts": 2} if row["sample"] == 2 else row for row in rows_of(young)]
        types = Manifest.load(Storage(str(young))).columns
        Storage(str(young)).write("shards/000001.parquet", index.encode(rows[2:], types))
        self.grown(tiny, young, cluster)
        assert [row["attempts"] for row in rows_of(young)] == [1, 1, 2, 1, 1]

    def test_it_does_not_shrink(self, tiny, young, cluster):
        with pytest.raises(InputError, match=r"count: expected 3, .* or more.*got 2"):
            make_dataset(*tiny, str(young), 2, cluster, seed=SEED, resume=True)


class TestCluster:
    def test_a_task_that_kills_its_workers_is_a_failed_sample(self, tiny, cluster, tmp_path):
        # What the scheduler raises after the last worker died; the real thing is a slow test.
        class Dying:
            killed = KeyError
            allowed_deaths = 4

            def __init__(self):
                self.results = {}

            def call(self, function):
                return function()

            def threads(self):
                return 1

            def submit(self, function, *arguments):
                self.results[len(self.results)] = (function, arguments)
                return len(self.results) - 1

            def finished(self, futures):
                return futures

            def result(self, future):
                function, arguments = self.results[future]
                if function is tasks.make and arguments[1] == 0:
                    raise KeyError("killed")
                return function(*arguments)

        url = str(tmp_path / "set")
        assert make_dataset(*tiny, url, 2, Dying(), seed=SEED).failed == 1
        row = rows_of(url)[0]
        assert row["attempts"] == 4
        assert "worker died" in row["reason"]

    def test_few_samples_are_handed_out_at_a_time(self, tiny, tmp_path):
        most = []

        class Lost:
            killed = KeyError

            def call(self, function):
                return function()

            def threads(self):
                return 3

            def submit(self, function, *arguments):
                return object()

            def finished(self, futures):
                most.append(len(futures))
                raise LostError("gone")

        with pytest.raises(LostError):
            make_dataset(*tiny, str(tmp_path / "set"), 1000, Lost(), seed=SEED)
        assert most == [6]
        assert not (tmp_path / "set" / "run.json").exists()


class TestVerify:
    def test_a_whole_one_is_whole(self, made):
        problems, found = verify_dataset(made)
        assert problems == []
        assert (found["samples"], found["failed"], found["shards"]) == (COUNT, 0, 3)

    def test_a_flipped_byte_is_found_wherever_it_is(self, copy):
        row = rows_of(copy)[3]
        rng = np.random.default_rng(0)
        for place in rng.integers(row["offset"], row["offset"] + row["size"], 5):
            flip(copy / row["shard"], place)
            problems = verify_dataset(str(copy))[0]
            assert problems == [
                f"{copy}/{row['shard']}: sample 000003: its SHA-256 is not the index's"
            ]
            flip(copy / row["shard"], place)
        assert verify_dataset(str(copy))[0] == []

    def test_a_truncated_shard_is_named(self, copy):
        row = rows_of(copy)[1]
        shard = copy / row["shard"]
        shard.write_bytes(shard.read_bytes()[: row["offset"] + 100])
        problems = verify_dataset(str(copy))[0]
        assert any("000000.tar: sample 000001" in p and "ends before" in p for p in problems)
        assert all("000000.tar" in p for p in problems)

    def test_a_cut_end_mark_is_named(self, copy):
        shard = copy / "shards" / "000001.tar"
        shard.write_bytes(shard.read_bytes()[: -len(END)])
        (problem,) = verify_dataset(str(copy))[0]
        assert "000001.tar: expected" in problem

    def test_what_is_missing_is_named(self, copy):
        (copy / "shards" / "000001.tar").unlink()
        (problem,) = verify_dataset(str(copy))[0]
        assert "000001.tar" in problem
        (copy / "index.parquet").unlink()
        problems = verify_dataset(str(copy))[0]
        assert any("index.parquet" in p and "--resume" in p for p in problems)
        with pytest.raises(InputError, match=r"index\.parquet"):
            information(str(copy))
        (copy / "dataset.json").unlink()
        with pytest.raises(InputError, match=r"dataset\.json"):
            verify_dataset(str(copy))

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda rows: rows.pop(2), "1 of 5 samples missing, the first 2"),
            (lambda rows: rows.append(rows[1]), "sample 1 stands there more than once"),
            (lambda rows: rows[2].update(height_mm=99.0), "column height_mm"),
            (lambda rows: rows[2].update(p0r0_rms_mm=0.0), "column p0r0_rms_mm"),
            (lambda rows: rows[3].update(offset=512), "expected at byte"),
            (lambda rows: rows[0].update(sample=9), "sample 9 is beyond the 5"),
        ],
    )
    def test_an_index_that_is_not_the_shards_is_named(self, change, words, copy):
        rows = rows_of(copy)
        change(rows)
        types = Manifest.load(Storage(str(copy))).columns
        (copy / "index.parquet").write_bytes(index.encode(rows, types))
        assert any(words in problem for problem in verify_dataset(str(copy))[0])

    def spoil_index(self, copy, change):
        rows = rows_of(copy)
        change(rows)
        types = Manifest.load(Storage(str(copy))).columns
        (copy / "index.parquet").write_bytes(index.encode(rows, types))

    @pytest.mark.parametrize("column", ["key", "status", "offset", "size", "object", "draws"])
    def test_a_null_is_named_by_all_that_read_the_index(self, column, copy):
        self.spoil_index(copy, lambda rows: rows[1].update({column: None}))
        words = rf"index\.parquet: sample 1: {column}: expected"
        for read in (information, open_dataset):
            with pytest.raises(InputError, match=words):
                read(str(copy))
        assert any(re.search(words, problem) for problem in verify_dataset(str(copy))[0])

    @pytest.mark.parametrize("change", [{"size": 2**62}, {"offset": -9}, {"offset": 2**62}])
    def test_a_place_outside_the_shard_is_not_read(self, change, copy):
        self.spoil_index(copy, lambda rows: rows[0].update(change))
        problems = verify_dataset(str(copy))[0]
        assert any("000000.tar: sample 000000: expected" in p and "ends" in p for p in problems)
        # The other sample of the shard is not blamed.
        assert not any("sample 000001" in problem for problem in problems)

    def test_an_evil_member_is_named(self, copy):
        # All checksums hold: whoever wrote it gave them too.
        row = rows_of(copy)[4]
        content = (copy / row["shard"]).read_bytes()[: row["size"]]
        stream = io.BytesIO()
        with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as archive:
            archive.addfile(tarfile.TarInfo("000004.../../x.y"), io.BytesIO())
        content += stream.getvalue()[:512]
        (copy / row["shard"]).write_bytes(content + END)
        new = {"size": len(content), "sha256": digest(content)}
        self.spoil_index(copy, lambda rows: rows[4].update(new))
        types = Manifest.load(Storage(str(copy))).columns
        (copy / "shards" / "000002.parquet").write_bytes(index.encode([rows_of(copy)[4]], types))
        (problem,) = verify_dataset(str(copy))[0]
        assert "000002.tar: sample 000004" in problem
        assert "'000004.../../x.y'" in problem

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"description": 5}, "description: expected text"),
            ({"preview": "no"}, "preview: expected true or false"),
            ({"count": True}, "count: expected a whole number"),
            ({"seed": -1}, "seed: expected a whole number"),
            ({"columns": {"a": 5}}, r"columns\.a"),
            ({"columns": {"a": "double"}}, r"columns\.sample"),
            ({"drawn": 5}, "drawn: expected a list"),
            ({"drawn": "abc"}, "drawn: expected a list"),
            ({"drawn": ["zz"]}, "drawn: expected names of columns"),
            ({"captures": {"p0r0": 5}}, r"captures\.p0r0"),
            ({"captures": {"p0r0": {}}}, r"captures\.p0r0"),
            ({"files": {"../../x": "0"}}, "files: expected plain names"),
            ({"environment": {"libraries": 5}}, "environment.libraries: expected a table"),
        ],
    )
    def test_a_damaged_manifest_is_named(self, change, words, copy):
        path = copy / "dataset.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | change))
        for read in (information, verify_dataset, open_dataset):
            with pytest.raises(InputError, match=rf"dataset\.json: {words}"):
                read(str(copy))

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"specification": {}}, "specification"),
            ({"drawn": []}, "drawn is not that of its specification"),
            ({"captures": {}}, "captures is not that of its specification"),
        ],
    )
    def test_a_manifest_that_is_not_its_specifications_is_named(self, change, words, copy):
        path = copy / "dataset.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | change))
        problems = verify_dataset(str(copy))[0]
        assert any("dataset.json" in problem and words in problem for problem in problems)

    def test_missing_shards_are_one_line(self, copy):
        for shard in (0, 2):
            (copy / "shards" / f"{shard:06d}.tar").unlink()
            (copy / "shards" / f"{shard:06d}.parquet").unlink()
        (problem,) = verify_dataset(str(copy))[0]
        assert "shards/000000.tar" in problem
        assert "the first of 2" in problem

    def test_damaged_files_are_named(self, copy):
        (copy / "index.parquet").write_bytes(b"PAR1 and no more")
        (copy / "shards" / "notes.txt").write_text("mine")
        problems = verify_dataset(str(copy))[0]
        assert any("index.parquet" in p and "damaged" in p for p in problems)
        assert any("notes.txt" in p for p in problems)

    def test_an_unfinished_run_is_named(self, copy):
        Storage(str(copy)).write("run.json", b'{"token": "a"}')
        Storage(str(copy)).write("staging/000001.tar", b"")
        problems = verify_dataset(str(copy))[0]
        assert len(problems) == 2
        assert all("--resume" in problem for problem in problems)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted in /proc")
def test_reading_an_index_starts_no_threads(made):
    # Arrow's pools abort a process that ends soon after they started, one time in ten.
    script = (
        "import os, sys, pyarrow.parquet\n"
        "from slbench.datasets.store import index\n"
        "content = open(sys.argv[1], 'rb').read()\n"
        "before = len(os.listdir('/proc/self/task'))\n"
        "index.decode(content, 'index')\n"
        "index.types(content)\n"
        "print(len(os.listdir('/proc/self/task')) - before)\n"
    )
    child = subprocess.run(
        [sys.executable, "-c", script, f"{made}/index.parquet"], capture_output=True, text=True
    )
    assert child.stdout == "0\n", child.stderr


class TestEnvironment:
    def test_differences_are_named(self):
        now = environment()
        assert tasks.different(now, now | {"variant": "x"}) == ("variant", now["variant"], "x")
        other = now | {"libraries": now["libraries"] | {"scipy": "0"}}
        assert tasks.different(now, other) == ("scipy", now["libraries"]["scipy"], "0")
