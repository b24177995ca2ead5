"""Data sets read by the loaders that others use: webdataset, Hugging Face datasets, mlcroissant.

The loaders are an extra (``loaders``); what is not installed is skipped.
"""

import importlib
import io
import json
import re
import tarfile
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
import trimesh
import yaml
from dataset_specs import rows_of, write_spec
from outside_loaders import loader

from slbench.core.errors import InputError
from slbench.datasets.croissant import write_croissant
from slbench.datasets.make.cluster import local_cluster
from slbench.datasets.make.engine import make_dataset
from slbench.datasets.read.reader import open_dataset
from slbench.datasets.spec.specification import load
from slbench.datasets.store import sample, shards
from slbench.datasets.verify import verify_dataset
from slbench.report.pages.dataset import front_matter, write_card

COUNT = 6
#: As Hugging Face datasets 5.2 looks at, to know the members of all.
FIRST = 5


@pytest.fixture(scope="module")
def hugging_face(tmp_path_factory):
    """The library, off the network and with a cache of its own; what reads a place with it."""
    with pytest.MonkeyPatch.context() as patch:
        cache = tmp_path_factory.mktemp("cache")
        patch.setenv("HF_HUB_OFFLINE", "1")
        patch.setenv("HF_HOME", str(cache))
        library = loader("datasets")

        def read(*where, **options):
            options = {"split": "train", "cache_dir": str(cache / "datasets")} | options
            return library.load_dataset(*map(str, where), **options)

        yield read


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Blocks, which bring nothing, and two meshes, whose files stand in their samples alone."""
    folder = tmp_path_factory.mktemp("spec")
    trimesh.creation.box((20.0, 24.0, 6.0)).export(folder / "box.ply")
    trimesh.creation.cylinder(12.0, 8.0).export(folder / "round.stl")
    place = {"unit": "mm", "centre": True, "position_mm": [{"uniform": [-4.0, 4.0]}, 0.0, 0.0]}
    block = {"heights_mm": [3.0], "step_length_mm": 15.0, "width_mm": 30.0}
    objects = [
        {"name": "block", "kind": "step_block", "parameters": block},
        {"name": "mesh", "mesh": {"choice": ["box.ply", "round.stl"]}, **place},
    ]
    spec = write_spec(folder, objects=objects, samples_per_shard=4, constraints=None)
    url = tmp_path_factory.mktemp("data") / "set"
    with local_cluster(0) as cluster:
        result = make_dataset(*load(spec), str(url), COUNT, cluster, seed=2)
    assert result.failed == 0
    write_card(str(url))
    write_croissant(str(url))
    return url


@pytest.fixture(scope="module")
def data(made):
    return open_dataset(made)


def tars(made):
    return sorted(str(path) for path in made.glob("shards/*.tar"))


def in_tars(made):
    """Return the members of each sample as the tar files have them."""
    found = {}
    for path in tars(made):
        with tarfile.open(path) as archive:
            for entry in archive:
                key, _, name = entry.name.partition(".")
                found.setdefault(key, {})[name] = archive.extractfile(entry).read()
    return found


class TestMembers:
    def test_all_samples_have_the_same(self, made, data):
        stored = in_tars(made)
        assert len(stored) == COUNT
        assert len({tuple(members) for members in stored.values()}) == 1
        # Although what they bring differs, within those that a loader looks at first.
        brought = {frozenset(set(item.members) - set(stored[item.row["key"]])) for item in data}
        assert {frozenset(), frozenset({"mesh.box.ply"})} <= brought
        assert len({tuple(item.members) for item in data[:FIRST]}) > 1

    def test_what_they_bring_comes_back(self, made, data):
        assert verify_dataset(str(made))[0] == []
        for item in data:
            assert item.scene.objects[0].artefact.mesh.vertices.size

    def test_a_plain_zip_reader_reads_it(self, made, data, tmp_path):
        item = next(item for item in data if "mesh.box.ply" in item.members)
        path = tmp_path / "files.zip"
        path.write_bytes(in_tars(made)[item.row["key"]]["files.zip"])
        with zipfile.ZipFile(path) as archive:
            assert archive.namelist() == ["mesh.box.ply"]
            assert archive.read("mesh.box.ply") == item.members["mesh.box.ply"]
            assert archive.testzip() is None

    @pytest.mark.parametrize("name", ["../x.y", "/x.y", "scene.toml", "a", "a/b.c"])
    def test_names_that_lead_elsewhere_are_refused(self, name):
        # A foreign data set's: they would be written to wherever they say, or in another's place.
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            archive.writestr(name, b"x")
        content = shards.pack(0, {"scene.toml": b"", "files.zip": stream.getvalue()})
        with pytest.raises(InputError, match=r"here: files\.zip: expected files of the sample"):
            sample.unpack(0, content, "here")

    @pytest.mark.parametrize("packed", [b"", b"PK", b"no ZIP file at all"])
    def test_a_damaged_one_is_one_line(self, packed):
        content = shards.pack(0, {"files.zip": packed})
        with pytest.raises(InputError, match=r"here: files\.zip: expected a ZIP file"):
            sample.unpack(0, content, "here")


class TestWebDataset:
    def test_the_library_reads_every_sample(self, made):
        library = loader("webdataset")
        found = list(library.WebDataset(tars(made), shardshuffle=False))
        expected = in_tars(made)
        assert [one["__key__"] for one in found] == sorted(expected)
        for one in found:
            members = {name: value for name, value in one.items() if not name.startswith("__")}
            assert members == expected[one["__key__"]]

    def test_its_decoders_take_frames_and_scores(self, made, data):
        library = loader("webdataset")
        for one, item in zip(
            library.WebDataset(tars(made), shardshuffle=False).decode("l8"), data, strict=True
        ):
            np.testing.assert_array_equal(one["p0r0.frame.000.png"], item.frames[0])
            assert one["score.json"]["object"] == item.row["object"]


class TestHuggingFace:
    def test_it_reads_the_archives(self, made, hugging_face):
        for path in tars(made):
            keys = [key for key in in_tars(made) if int(key) // 4 == tars(made).index(path)]
            found = hugging_face("webdataset", data_files={"train": path})
            assert found["__key__"][:] == keys

    def test_it_did_not_when_members_differed(self, data, hugging_face, tmp_path):
        """As layout 2 had them: a mesh stood beside the other members."""
        content = b"".join(shards.pack(item.number, item.members) for item in data)
        (tmp_path / "old.tar").write_bytes(content + shards.END)
        with pytest.raises(Exception, match="same prefix or the same types"):
            hugging_face("webdataset", data_files={"train": str(tmp_path / "old.tar")})

    def test_the_folder_is_a_data_set_of_the_hub(self, made, data, hugging_face):
        found = hugging_face(made)
        assert found["__key__"][:] == [item.row["key"] for item in data]
        frame = np.asarray(found[1]["p0r0.frame.002.png"])
        np.testing.assert_array_equal(frame, data[1].frames[2])
        assert found[1]["provenance.json"]["seed"] == data[1].seed

    def test_it_reads_the_index(self, made, hugging_face):
        found = hugging_face("parquet", data_files={"train": str(made / "index.parquet")})
        assert found.to_list() == rows_of(made)

    def test_the_card_is_one_of_the_hub(self, made, hugging_face):
        card = importlib.import_module("huggingface_hub").DatasetCard.load(made / "README.md")
        assert card.data.license == "cc0-1.0"
        assert card.data.size_categories == ["n<1K"]
        assert card.text.lstrip().startswith("# tiny")


@pytest.mark.parametrize(("number", "name"), [(0, "datasets"), (1, "webdataset")])
def test_the_pages_snippets_run(number, name, made, data, hugging_face, tmp_path, monkeypatch):
    loader(name)
    page = (Path(__file__).parents[2] / "docs/how-to/datasets-use.md").read_text()
    part = page[page.index("## Without slbench") : page.index("## Other layouts")]
    snippet = re.findall(r"^```python\n(.*?)^```", part, re.M | re.S)[number]
    (tmp_path / "data").symlink_to(made)
    monkeypatch.chdir(tmp_path)
    scope = {}
    exec(compile(snippet, "datasets-use.md", "exec"), scope)
    if name == "datasets":
        assert len(scope["samples"]) == len(scope["rows"]) == COUNT
        np.testing.assert_array_equal(np.asarray(scope["picture"]), data[0].frames[0])
    else:
        assert [one["__key__"] for one in scope["samples"]] == [f"{k:06d}" for k in range(4)]


class TestCard:
    def test_front_matter_is_yaml(self, made):
        _, head, text = (made / "README.md").read_text().split("---\n", 2)
        values = yaml.safe_load(head)
        files = [one["path"] for config in values["configs"] for one in config["data_files"]]
        assert [len(list(made.glob(pattern))) for pattern in files] == [2]
        assert text.lstrip().startswith("# tiny")

    @pytest.mark.parametrize(
        ("licence", "expected"),
        [
            ("CC-BY-4.0", {"license": "cc-by-4.0"}),
            ("not stated", {"license": "unknown"}),
            ("in-house: ask", {"license": "other", "license_name": "in-house: ask"}),
        ],
    )
    @pytest.mark.parametrize(
        ("samples", "size"), [(0, "n<1K"), (999, "n<1K"), (1000, "1K<n<10K"), (10**6, "n>1M")]
    )
    def test_licence_and_size_by_the_hubs_names(self, licence, expected, samples, size, data):
        lines = front_matter(replace(data.manifest, licence=licence), samples)
        assert (lines[0], lines[-2:]) == ("---", ["---", ""])
        values = yaml.safe_load("\n".join(lines[1:-2]))
        assert {key: values[key] for key in values if key.startswith("license")} == expected
        assert values["size_categories"] == [size]


class TestCroissant:
    def test_mlcroissant_validates_it(self, made):
        library = loader("mlcroissant")
        read = library.Dataset(str(made / "croissant.json"))
        issues = read.metadata.ctx.issues
        assert not issues.errors
        # When it is published is not known, and would make two equal data sets differ.
        assert len(issues.warnings) == 1
        assert "datePublished" in next(iter(issues.warnings))
        assert read.metadata.name == "tiny"

    def test_its_records_are_the_index(self, made):
        library = loader("mlcroissant")
        read = library.Dataset(str(made / "croissant.json"))
        for record, row in zip(read.records("samples"), rows_of(made), strict=True):
            for name, value in row.items():
                found = record[f"samples/{name}"]
                found = found.decode() if isinstance(found, bytes) else found
                assert found == value or (value is None and found != found), name

    def test_it_names_what_is_there(self, made):
        content = json.loads((made / "croissant.json").read_text())
        index, archives = content["distribution"]
        assert shards.digest((made / index["contentUrl"]).read_bytes()) == index["sha256"]
        assert len(list(made.glob(archives["includes"]))) == 2
        columns = [f["source"]["extract"]["column"] for f in content["recordSet"][0]["field"]]
        assert columns == pyarrow.parquet.read_schema(made / "index.parquet").names
