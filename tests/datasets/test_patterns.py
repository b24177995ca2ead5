"""Pattern sets of every form in a data set, which keeps all that workers and readers need."""

import json

import numpy as np
import pytest
import tomli_w
from dataset_specs import TINY, write_spec
from scenes_small import check_refused, run_cli, small

from slbench.core.errors import InputError
from slbench.core.io.images import write_png
from slbench.datasets.make.cluster import local_cluster
from slbench.datasets.make.engine import make_dataset
from slbench.datasets.manifest import Manifest
from slbench.datasets.read.reader import open_dataset
from slbench.datasets.spec.specification import from_dict, load
from slbench.datasets.store.storage import Storage
from slbench.datasets.verify import verify_dataset
from slbench.patterns import Fringes, PatternSequence, read_patterns

PANEL = (640, 480)
MODULE = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from slbench.patterns import Axis, Fringes, MatchedCode, PatternSequence, pattern_codes


@pattern_codes.register("kept-waves")
@dataclass(frozen=True)
class Waves(MatchedCode):
    kind: ClassVar[str] = "kept-waves"

    count: float = 9.0
    axis: Axis = "u"

    def n_frames(self, panel):
        return 6

    def profile(self, k, size):
        turns = (1.0, self.count)[k // 3] * (np.arange(size) + 0.5) / size + k % 3 / 3
        return 0.5 + 0.5 * np.cos(2 * np.pi * turns)


WAVES = Waves(12.0)


def plain(panel):
    return PatternSequence(panel, (Fringes(1, 3, "u"), Fringes(panel[0] // 64, 4, "u")))
"""
FORMS = [
    "1,10",
    "set.toml",
    "pictures",
    "mine.py:WAVES",
    "mine.py:plain",
    {"parts": [{"kind": "fringes", "count": 1, "shifts": 5, "axis": "u"}], "unwrap": "none"},
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a specification that names a set in every form."""
    folder = tmp_path_factory.mktemp("spec")
    (folder / "mine.py").write_text(MODULE)
    parts = PatternSequence.parse("gray+8@4", PANEL).to_dict()["parts"]
    (folder / "set.toml").write_text(tomli_w.dumps({"parts": parts, "max_order_residual": 0.4}))
    (folder / "pictures").mkdir()
    shown = PatternSequence.parse("1@4,4@4,7@3", PANEL).images()
    for k, picture in enumerate(shown):  # eleven: 10 comes after 9
        write_png(folder / "pictures" / f"{k}.png", np.rint(255 * picture).astype(np.uint8))
    patterns = [{"sequence": one} if isinstance(one, str) else one for one in FORMS[:-1]]
    patterns[1] |= {"repeats": 2}
    write_spec(folder, patterns=patterns, objects=TINY["objects"][:1])
    return folder


@pytest.fixture(scope="module")
def expected(folder):
    options = {"folder": folder, "allow_modules": True}
    return [read_patterns(form, PANEL, **options).sequence for form in FORMS[:-1]]


@pytest.fixture(scope="module")
def made(folder, tmp_path_factory):
    url = str(tmp_path_factory.mktemp("data") / "set")
    specification, files = load(folder / "tiny.toml", allow_modules=True)
    with local_cluster(0) as cluster:
        result = make_dataset(specification, files, url, 1, cluster, seed=1)
    assert result.failed == 0
    return url


def test_captures_of_every_form_are_read_back(made, expected):
    problems, _ = verify_dataset(made)
    assert problems == []
    (item,) = open_dataset(made, allow_modules=True)
    names = ["p0r0", "p1r0", "p1r1", "p2r0", "p3r0", "p4r0"]
    assert item.captures == tuple(names)
    for name in names:
        shots = item.stored(name)
        sequence = expected[int(name[1])]
        assert shots.sequence == sequence
        # The frames are those of the sequence in the sample's light: exposing it again without
        # noise differs by the detector's noise alone.
        clean = item.capture(sequence, noise=False).frames.astype(float)
        deviation = np.sqrt(np.mean((shots.frames - clean) ** 2))
        assert 0.1 < deviation < 4.0
        assert shots.decode().mask.mean() > 0.05
    np.testing.assert_array_equal(
        item.stored("p0r0").frames, item.capture("1,10", seed=item.seed).frames
    )


def test_the_data_set_holds_what_it_needs(made, folder):
    manifest = Manifest.load(Storage(made))
    pictures = [f"images.p2-0.{k:02d}.png" for k in range(11)]
    assert set(manifest.files) == {"module.mine.py", *pictures}
    assert manifest.specification["modules"] == ("module.mine.py",)
    names = [manifest.captures[f"p{k}r0"].get("name") for k in range(5)]
    assert names == [None, "set", "pictures", "mine:WAVES", "mine:plain"]
    assert manifest.captures["p0r0"] == {"sequence": "1,10", "shifts": 3, "axes": "u", "repeats": 1}


def test_sets_are_chosen_when_samples_are_read(made, folder, expected, monkeypatch):
    monkeypatch.chdir(folder)
    (item,) = open_dataset(made, allow_modules=True)
    for form, sequence in zip(FORMS, expected, strict=False):
        assert item.capture(form, noise=False).sequence == sequence
    (item,) = open_dataset(made)
    with pytest.raises(InputError, match="--allow-modules"):
        item.capture("mine.py:WAVES")


def test_parts_stand_in_the_specification_too(tmp_path):
    path = write_spec(tmp_path, patterns=[FORMS[-1]])
    specification, files = load(path)
    (patterns,) = specification.patterns
    assert (files, patterns.parts, patterns.unwrap) == ({}, tuple(FORMS[-1]["parts"]), "none")


def test_shifts_and_axes_that_are_not_stated_are_the_scene_s(tmp_path):
    scene = TINY["scene"] | {"patterns": {"shifts": 5, "axes": "v"}}
    own = PatternSequence.parse("1,4", PANEL, 4).to_dict()["parts"]
    (tmp_path / "set.toml").write_text(tomli_w.dumps({"parts": own}))
    (tmp_path / "words.toml").write_text('[patterns]\nsequence = "1,8"\n')
    given = [
        {"sequence": "1,10"},
        {"sequence": "1,10", "shifts": 4, "axes": "u"},
        {"sequence": "1,10@7"},
        {"sequence": "words.toml"},
        {"sequence": "set.toml"},
    ]
    specification, _ = load(write_spec(tmp_path, patterns=given, scene=scene))
    assert specification == from_dict(specification.model_dump(mode="json"), "dataset.json")
    made = small("plane")
    found = [patterns.of(made, tmp_path).sequence for patterns in specification.patterns]
    assert [(one.parts[-1].shifts, one.axes) for one in found] == [
        (5, ("v",)),
        (4, ("u",)),
        (7, ("v",)),
        (5, ("v",)),
        (4, ("u",)),
    ]


def test_shifts_of_a_scene_that_are_drawn_are_no_value(tmp_path):
    scene = TINY["scene"] | {"patterns": {"shifts": {"integers": [3, 5]}}}
    with pytest.raises(InputError, match=r"patterns\[0\].shifts: expected a value, as .* drawn"):
        load(write_spec(tmp_path, patterns=[{"sequence": "1,10"}], scene=scene))
    load(write_spec(tmp_path, patterns=[{"sequence": "1,10", "shifts": 3}], scene=scene))


def test_the_command_makes_and_exports_them(folder, tmp_path):
    make = ["dataset", "make", folder / "tiny.toml", "--out", tmp_path / "made", "--count", 1]
    make += ["--workers", 0, "--preview", "--json"]
    check_refused(run_cli(*make), "tiny.toml: patterns[3]", "--allow-modules", "mine.py:WAVES")
    done = run_cli(*make, "--allow-modules")
    assert done.status == 0, done.err
    export = ["dataset", "export", tmp_path / "made", "--format", "frames", "--json"]
    export += ["--out", tmp_path / "frames", "--patterns", folder / "set.toml"]
    done = run_cli(*export, "--allow-modules")
    assert done.status == 0, done.err
    assert json.loads(done.out.splitlines()[-1])["samples"] == 1
    assert "set" in (tmp_path / "made" / "README.md").read_text()


@pytest.mark.parametrize(
    ("patterns", "changes", "words"),
    [
        (
            {"sequence": "gone.toml"},
            {},
            "patterns[0]: patterns: expected a TOML file that is there",
        ),
        ({"sequence": "../set.toml"}, {}, "a relative path inside"),
        ({}, {}, "patterns[0]: expected a sequence or parts, got neither"),
        ({"sequence": "1,8", "parts": []}, {}, "patterns[0]"),
        ({"sequence": "set.toml", "axes": "uv"}, {}, "axes: expected none beside set"),
        ({"sequence": "set.toml", "shifts": 4}, {}, "shifts: expected none beside set"),
        ({"sequence": "1,8", "name": "x"}, {}, "patterns[0].name: expected no such key"),
        ({"sequence": "set.toml"}, {"marginals": ["v"]}, "'u' too, which patterns[0] code"),
        (
            {"sequence": "set.toml"},
            {"resolution_px": [{"integers": [600, 640]}, 480]},
            "patterns in words, as the panel's size is drawn",
        ),
    ],
)
def test_what_says_too_little_or_too_much_is_refused(folder, tmp_path, patterns, changes, words):
    (tmp_path / "set.toml").write_bytes((folder / "set.toml").read_bytes())
    scene = dict(TINY["scene"])
    if "resolution_px" in changes:
        scene["projector"] = {"resolution_px": changes.pop("resolution_px")}
    with pytest.raises(InputError) as caught:
        load(write_spec(tmp_path, patterns=[patterns], scene=scene, **changes))
    assert words in str(caught.value)


@pytest.mark.slow
def test_workers_have_pictures_and_modules(folder, tmp_path):
    make = ["dataset", "make", folder / "tiny.toml", "--out", tmp_path / "made", "--count", 2]
    done = run_cli(*make, "--workers", 1, "--json", "--allow-modules")
    assert done.status == 0, done.err
    assert json.loads(done.out.splitlines()[-1])["failed"] == 0


def test_fringes_are_fringes(expected):
    assert expected[4].parts == (Fringes(1, 3, "u"), Fringes(10, 4, "u"))
