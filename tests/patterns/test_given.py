"""Pattern sets read from short text, files, folders, modules and objects are the same set."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from slbench.capture.capture import Capture
from slbench.capture.shown import write_pictures
from slbench.core import modules
from slbench.core.errors import InputError
from slbench.core.io import provenance
from slbench.core.io.images import write_png
from slbench.patterns import Fringes, PatternSequence, pattern_codes, read_patterns
from slbench.patterns.images import Images

PANEL = (96, 64)
TEXT = "gray+4@5"
SEQUENCE = PatternSequence.parse(TEXT, PANEL)
MODULE = """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from slbench.patterns import Code, Fringes, GrayCode, PatternSequence, pattern_codes

CODES = [GrayCode("u"), Fringes(4, 5, "u")]
CODE = Fringes(1, 4, "v")
SET = PatternSequence((96, 64), tuple(CODES))


def make(panel):
    return PatternSequence(panel, (GrayCode("u"), Fringes(panel[0] // 24, 5, "u")))


def codes(panel):
    return CODES


def broken(panel):
    raise KeyError("no such thing")


class Shelf:
    first = CODES


@dataclass(frozen=True)
class Plain(Code):
    kind: ClassVar[str] = "given-plain"
    axis: str = "u"

    def n_frames(self, panel):
        return 1

    def profile(self, k, size):
        return np.linspace(0.0, 1.0, size)


@pattern_codes.register("given-known")
@dataclass(frozen=True)
class Known(Plain):
    kind: ClassVar[str] = "given-known"


PLAIN = Plain()
NUMBER = 3
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the same set in every form."""
    folder = tmp_path_factory.mktemp("given")
    (folder / "mine.py").write_text(MODULE)
    table = SEQUENCE.to_dict()
    (folder / "whole.toml").write_text(tomli_w.dumps(table))
    (folder / "parts.toml").write_text(tomli_w.dumps({"parts": table["parts"]}))
    manifest = {"frames": ["no.png"], "patterns": table}
    (folder / "manifest.toml").write_text(tomli_w.dumps(manifest))
    scene = {"name": "any", "patterns": {"sequence": TEXT}}
    (folder / "scene.toml").write_text(tomli_w.dumps(scene))
    write_pictures(SEQUENCE, folder / "session")
    (folder / "kept").mkdir()
    (folder / "kept" / "patterns.toml").write_text(tomli_w.dumps(table))
    return folder


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("whole.toml", "whole"),
        ("parts.toml", "parts"),
        ("manifest.toml", "manifest"),
        ("scene.toml", "scene"),
        ("session", "session"),
        ("session/", "session"),
        ("kept", "kept"),
        ("mine.py:SET", "mine:SET"),
        ("mine.py:CODES", "mine:CODES"),
        ("mine.py:make", "mine:make"),
        ("mine.py:codes", "mine:codes"),
        ("mine.py:Shelf.first", "mine:Shelf.first"),
        (" gray + 4@5 ", "gray+4@5"),
    ],
)
@pytest.mark.parametrize("typed", [True, False], ids=["by a person", "in a file"])
def test_every_form_is_the_same_set(folder, monkeypatch, given, name, typed):
    monkeypatch.chdir(folder if typed else Path("/"))
    where = {} if typed else {"folder": folder}
    found = read_patterns(given, PANEL, allow_modules=True, **where)
    assert found.sequence == SEQUENCE
    assert found.name == name


@pytest.mark.parametrize(
    "given",
    [
        SEQUENCE,
        list(SEQUENCE.parts),
        SEQUENCE.parts,
        lambda panel: SEQUENCE.parts,
        SEQUENCE.to_dict(),
        {"parts": SEQUENCE.to_dict()["parts"]},
        {"sequence": TEXT},
    ],
    ids=["sequence", "list", "tuple", "callable", "table", "parts", "words"],
)
def test_objects_of_a_program_are_the_same_set(given):
    found = read_patterns(given, PANEL)
    assert found.sequence == SEQUENCE
    assert found.name == SEQUENCE.name


def test_paths_and_one_code(folder):
    assert read_patterns(folder / "whole.toml", PANEL).sequence == SEQUENCE
    assert read_patterns(folder / "session", PANEL).name == "session"
    one = read_patterns(Fringes(1, 4, "v"), PANEL).sequence
    assert one == PatternSequence(PANEL, (Fringes(1, 4, "v"),))


def test_words_come_before_a_folder_of_their_name(folder, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    write_pictures(SEQUENCE, tmp_path / "gray")
    assert read_patterns("gray", PANEL).sequence == PatternSequence.parse("gray", PANEL)
    assert read_patterns("./gray", PANEL).sequence == SEQUENCE
    assert read_patterns("gray/", PANEL).name == "gray"


@pytest.mark.parametrize("axes", ["u", "v", "uv"])
def test_text_takes_shifts_and_axes_and_nothing_else_does(folder, axes):
    options = {"shifts": 7, "axes": axes, "folder": folder}
    found = read_patterns("1,8", PANEL, **options)
    assert found.sequence == PatternSequence.parse("1,8", PANEL, 7, axes)
    assert not found.own_axes
    found = read_patterns("whole.toml", PANEL, **options)
    assert found.sequence == SEQUENCE
    assert found.own_axes


def test_a_class_codes_the_axes_that_are_asked_for(folder):
    options = {"folder": folder, "allow_modules": True}
    found = read_patterns("mine.py:Known", PANEL, axes="uv", **options)
    assert found.sequence.axes == ("u", "v")
    assert not found.own_axes
    family = pattern_codes.get("given-known")
    assert found.sequence == PatternSequence(PANEL, (family("u"), family("v")))


@pytest.mark.parametrize(("along", "coded"), [("u", "u"), ("v", "v"), ("uv", "uv")])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_folder_of_pictures_is_a_code_in_natural_order(tmp_path, along, coded, dtype):
    rng = np.random.default_rng(1)
    shape = (11, PANEL[1] if "v" in along else 1, PANEL[0] if "u" in along else 1)
    pictures = rng.integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    pictures = np.broadcast_to(pictures, (11, PANEL[1], PANEL[0]))
    for k, picture in enumerate(pictures):
        write_png(tmp_path / f"mine-{k}.png", picture)  # 10 after 9
    found = read_patterns(str(tmp_path), PANEL)
    assert found.sequence == PatternSequence(PANEL, (Images(pictures, coded),))
    assert found.name == tmp_path.name
    # And it is kept beside a capture, and read back.
    frames = np.full((11, 4, 5), 100, np.uint8)
    Capture(frames, found.sequence).save(tmp_path / "capture")
    assert Capture.load(tmp_path / "capture").sequence == found.sequence
    assert read_patterns(tmp_path / "capture", PANEL).sequence == found.sequence


def test_a_set_may_keep_its_own_panel(folder):
    with pytest.raises(InputError, match=r"whole.toml: patterns.panel: expected patterns for the"):
        read_patterns("whole.toml", (640, 480), folder=folder)
    found = read_patterns("whole.toml", (640, 480), folder=folder, keep_panel=True)
    assert found.sequence.panel == PANEL
    found = read_patterns("parts.toml", (640, 480), folder=folder, keep_panel=True)
    assert found.sequence.panel == (640, 480)


def test_a_module_is_known_by_path_and_hash(folder, monkeypatch):
    monkeypatch.setattr(modules, "_run", {})
    (folder / "other.py").write_text(MODULE.replace("given-", "other-"))
    read_patterns("other.py:SET", PANEL, folder=folder, allow_modules=True)
    digest = hashlib.sha256((folder / "other.py").read_bytes()).hexdigest()
    written = provenance({}, None)["extensions"]["modules"]
    assert written == [{"path": str(folder / "other.py"), "sha256": digest}]


def test_a_module_that_is_imported_is_known_too(tmp_path, monkeypatch):
    monkeypatch.setattr(modules, "_run", {})
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "given_package").mkdir()
    (tmp_path / "given_package" / "__init__.py").touch()
    source = tmp_path / "given_package" / "sets.py"
    source.write_text(MODULE.replace("given-", "imported-"))
    found = read_patterns("given_package.sets:make", PANEL, allow_modules=True)
    assert found.sequence == SEQUENCE
    assert found.name == "given_package.sets:make"
    digest = hashlib.sha256(source.read_bytes()).hexdigest()
    assert modules.used_modules() == [{"path": str(source), "sha256": digest}]
    assert pattern_codes.origin("imported-known") == str(source)


def test_a_code_of_a_module_is_read_back_from_its_capture(folder, tmp_path):
    found = read_patterns("mine.py:Known", PANEL, folder=folder, allow_modules=True)
    frames = np.full((1, 4, 5), 100, np.uint8)
    Capture(frames, found.sequence).save(tmp_path / "capture")
    assert (tmp_path / "capture" / "mine.py").read_text() == MODULE
    with pytest.raises(InputError, match="--allow-modules"):
        Capture.load(tmp_path / "capture")
    again = Capture.load(tmp_path / "capture", allow_modules=True)
    assert again.sequence == found.sequence


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("", "text such as"),
        ("grey", "'grey'; did you mean 'gray'?"),
        ("1,8@2", "Fringes: shifts"),
        ("hole.toml", "a TOML file that is there, got hole.toml; did you mean 'whole.toml'?"),
        ("kept/hole.toml", "a TOML file that is there"),
        (
            "session/patters",
            "a folder that is there, got session/patters; did you mean 'patterns'?",
        ),
        ("mine.py:SETS", "expected an object of mine.py, got 'SETS'; did you mean 'SET'?"),
        ("mine.py:Shelf.second", "expected an object of mine.py, got 'second'"),
        ("mime.py:SET", "a Python file that can be read, got mime.py"),
        ("mime.py:SET", "did you mean 'mine.py'?"),
        ("mine.py:NUMBER", "mine.py:NUMBER: expected a PatternSequence, a Code, a list"),
        ("mine.py:broken", "mine.py:broken: expected a function that takes the panel"),
        ("mine.py:PLAIN", '@pattern_codes.register("given-plain") above its class, got Plain'),
        (
            "given_nothing:SET",
            "a module that can be imported, or a Python file (.py), got 'given_n",
        ),
        ("fails.py:SET", "fails.py: expected a module that runs, got ZeroDivisionError"),
        ("empty", "pictures in"),
        ("mixed", "expected pictures like 0.png, got 1.png, of other size"),
        ("list.toml", "list.toml: patterns: expected a table with parts or a sequence"),
        ("keys.toml", "got 'part'; did you mean 'parts'?"),
        ("word.toml", "got 'sequenc'; did you mean 'sequence'?"),
        ("asks.toml", "asks.toml: modules"),
        ("x" * 5000, "x"),
        ("a\0b", "a"),
        ("../" + "x" * 20, "a relative path inside"),
    ],
)
def test_what_is_no_set_is_refused_in_one_line(folder, given, words):
    (folder / "empty").mkdir(exist_ok=True)
    (folder / "mixed").mkdir(exist_ok=True)
    for k, size in enumerate((PANEL, (8, 8))):
        write_png(folder / "mixed" / f"{k}.png", np.zeros(size[::-1], np.uint8))
    (folder / "fails.py").write_text("1 / 0")
    (folder / "list.toml").write_text("[[patterns]]\nsequence = 'gray'\n")
    (folder / "keys.toml").write_text("part = []\n")
    (folder / "word.toml").write_text("[patterns]\nsequenc = 'gray'\n")
    (folder / "asks.toml").write_text("modules = ['gone.py']\nparts = []\n")
    with pytest.raises(InputError) as caught:
        read_patterns(given, PANEL, folder=folder, allow_modules=True)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_paths_in_a_file_stay_in_its_folder(folder, tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "other").mkdir()
    for given in (str(folder / "whole.toml"), "../whole.toml", "../mine.py:SET", "../other"):
        with pytest.raises(InputError, match="a relative path inside"):
            read_patterns(given, PANEL, folder=tmp_path / "inner", allow_modules=True)


@pytest.mark.parametrize("given", ["mine.py:SET", "asks.toml", "json.tool:main"])
def test_no_code_runs_unless_it_is_allowed(folder, given):
    (folder / "asks.toml").write_text("modules = ['mine.py']\nparts = []\n")
    with pytest.raises(InputError, match="--allow-modules"):
        read_patterns(given, PANEL, folder=folder)
