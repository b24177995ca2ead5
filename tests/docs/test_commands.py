"""Every command that a page shows runs, in the order of the page, in a folder of its own.

A full-size command runs with the options of `REDUCED` added, which makes it small and leaves all
else as it stands.  What a page takes for granted, such as a folder of photographs, is made by
`GIVEN` where no command before has written it.  The tour is checked word by word elsewhere.
"""

import functools
import glob
import importlib.util
import re
import shlex
import shutil

import cv2
import numpy as np
import pytest
from calibrations import (
    DIST_CAMERA,
    DIST_PROJECTOR,
    K_CAMERA,
    K_PROJECTOR,
    R,
    T,
    storage,
)
from focus_stacks import slanted_plane
from pages import ALL, DOCS, FENCE, ROOT, named_commands, shown_commands, text_of
from scenes_small import run_cli
from several_photographed import SPECKLE
from several_photographed import photograph as photograph_several
from stage_views import stage_views

from slbench.capture.capture import Capture
from slbench.cli import app, bench
from slbench.core.io import write_ply, write_png, write_table

PAGES = [page for page in [*ALL, ROOT / "results" / "README.md"] if page.name != "tour.md"]

#: Options that make a command small, by its words; those that it has already are left out.
REDUCED = {
    "scan": "--preview",
    "compare": "--preview --repeats 2",
    "check": "--preview",
    "bench": "--preview",
    "calibrate run": "--z-steps 4 --y-steps 1 --spp 4",
    "design rig": "--evaluations 200",
    "design verify": "--spp 1 --count 3",
    "design views": "--preview --candidates 24 --samples 1000",
    "design patterns --scene": "--preview --repeats 2 --scans 2",
    "design patterns --learn": "--steps 20 --scans 2",
    "design adaptive": "--repeats 2 --frames 12 --spp 2 --divisor 8",
    "design noise": "--preview --repeats 2 --heights 2 --max-fringes 4",
    "dataset make": "--preview --count 3 --workers 0",
}

#: Commands that run with other words.
INSTEAD = {
    # Two scenes of nineteen.
    " step-block step-block-grainy plane sphere v-groove acceptance-macro acceptance-micro ambient"
    " bowl ch6-brick ch6-gear ch6-propeller ch7-engine-block ch7-gear ch7-propeller ch7-step-block"
    " ch8-coin-3": "",
    # No gear is among three samples.
    "kind == 'gear'": "lit_pixels > 0",
    # Three of the 18 rigs.
    "design verify hardware/macro-ch6 scenes/hardware/table4.csv": (
        "design verify hardware/macro-ch6 few.csv"
    ),
    # A focus stack at a quarter of the width is 16 times the work of its preview.
    "--divisor 4": "--divisor 8",
    # A tenth of a minute and a half.
    "--draws 2000": "--draws 200",
}

#: Pages whose commands take a second or two.
QUICK = {"register.md", "own-codes.md", "diagnose.md"}


# -- what a page takes for granted --------------------------------------------------------------


def capture_of(scene, path, seed=0):
    assert run_cli("scan", scene, "--preview", "--seed", seed, "--out", path).status == 0


def shots():
    frames = slanted_plane(frames=5).stack()
    return [np.rint(255 * np.clip(frame, 0, 1)).astype(np.uint8) for frame in frames]


def photographs(path):
    path.mkdir()
    for number, frame in enumerate(shots()):
        cv2.imwrite(str(path / f"{number}.png"), frame)


def noise_table(path):
    rows = [(fringes, 0.0, 0.05) for fringes in (1, 2, 4, 8, 16, 32, 64)]
    write_table(path, ("fringes", "z_mm", "sigma_rad"), np.array(rows))


def few_rigs(path):
    lines = (ROOT / "scenes" / "hardware" / "table4.csv").read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:4]))


@functools.cache
def views():
    return stage_views("rough", 3, seed=7, count=20_000)


def view(number, path):
    write_ply(path, views().clouds[number - 1], {})


def folder_of_views(path):
    path.mkdir()
    for number in (1, 2, 3):
        view(number, path / f"view{number}.ply")


def claims(path):
    """Write the claims file that the page on claims shows, with fewer repeats."""
    (text,) = (
        match[3]
        for match in FENCE.finditer(text_of(DOCS / "how-to" / "claims.md"))
        if match[3].startswith(f"# {path.name}\n")
    )
    text = re.sub(r"^(repeats|scans) = .*\n", "", text, flags=re.MULTILINE)
    path.write_text(text.replace("[[claim]]\n", "[[claim]]\nrepeats = 2\n"), encoding="utf-8")


def shown_file(page, path):
    """Write a file that a page shows, with its name in its first line."""
    (text,) = (
        match[3]
        for match in FENCE.finditer(text_of(DOCS / "how-to" / page))
        if match[3].startswith(f"# {path.name}\n")
    )
    path.write_text(text, encoding="utf-8")


def bars(path):
    """Scan the ball bar of an acceptance in three places, and list the clouds as the page does."""
    path.mkdir()
    for number in (1, 2, 3):
        scan = path.parent / f"scan{number}"
        moved = f"objects[0].position_mm=[{5.0 * (number - 2)}, 8.0, {2.0 * number}]"
        words = ("scan", "acceptance-macro", "--preview", "--set", moved, "--seed", number)
        assert run_cli(*words, "--out", scan).status == 0
        shutil.copy(scan / "cloud.ply", path / f"bar-{number}.ply")
    shown_file("accept.md", path / "places.toml")


def own_claims(path):
    """Write the claims of the page on one's own part, with fewer repeats."""
    shown_file("own-part.md", path)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("[[claim]]\n", "[[claim]]\nrepeats = 2\n"), encoding="utf-8")


def own_codes(path):
    """Write the Python file that the page on codes of one's own shows."""
    (code, _) = (
        match[3]
        for match in FENCE.finditer(text_of(DOCS / "how-to" / "own-codes.md"))
        if match[2] == "python"
    )
    path.write_text(code, encoding="utf-8")


def data_set(path):
    words = ("dataset", "make", "mixed", "--out", path, *REDUCED["dataset make"].split())
    assert run_cli(*words).status == 0


def slstudio(path):
    sizes = {"frameWidth": 1280, "frameHeight": 1024, "screenResX": 1280, "screenResY": 800}
    storage(
        path, Kc=K_CAMERA, kc=DIST_CAMERA, Kp=K_PROJECTOR, kp=DIST_PROJECTOR, Rp=R, Tp=T, **sizes
    )


def board_pictures(path):
    """Write what the camera saw of the board in the captures of the page, as plain pictures."""
    path.mkdir()
    for number in range(1, 7):
        shots = Capture.load(path.parent / "out" / f"pose{number}")
        write_png(path / f"{number}.png", np.rint(shots.decode().mean).astype(np.uint8))


GIVEN = {
    "pictures": board_pictures,
    "slstudio.xml": slstudio,
    "intrinsics.yml": lambda path: storage(path, M1=K_CAMERA, M2=K_PROJECTOR),
    "extrinsics.yml": lambda path: storage(path, R=R, T=T),
    "points.csv": lambda path: shutil.copy(ROOT / "results" / "calibration" / "points.csv", path),
    "stack.tif": lambda path: cv2.imwritemulti(str(path), shots()),
    "few.csv": few_rigs,
    "heights.csv": lambda path: write_table(
        path, ("z_mm",), [(z,) for z in (-8.0, -4.0, 0.0, 4.0, 8.0)]
    ),
    "noise.csv": noise_table,
    "accuracy.claims.toml": claims,
    "budget.toml": functools.partial(shown_file, "uncertainty.md"),
    "part.toml": functools.partial(shown_file, "own-part.md"),
    "bench.toml": functools.partial(shown_file, "own-part.md"),
    "part.claims.toml": own_claims,
    "limits.toml": functools.partial(shown_file, "accept.md"),
    "measured": bars,
    "mine.py": own_codes,
    "photographs": photographs,
    "two-cameras": photograph_several,
    "speckled": functools.partial(photograph_several, patterns=SPECKLE),
    "data": data_set,
    "views": folder_of_views,
    "stage.csv": lambda path: write_table(path, ("x_mm", "y_mm", "z_mm"), views().positions),
    **{f"view{k}.ply": functools.partial(view, k) for k in (1, 2, 3)},
    **{f"run{k}": functools.partial(capture_of, "plane", seed=k) for k in (1, 2, 3)},
    "out/step-block": functools.partial(capture_of, "step-block"),
    "out/ch8-plane": functools.partial(capture_of, "ch8-plane"),
    "out/coin": functools.partial(capture_of, "ch8-coin-3"),
}


# -- the commands -------------------------------------------------------------------------------


def command_of(words):
    """Return the words that name a command, and the command; None for a group."""
    command, count = app, 0
    while hasattr(command, "commands"):
        if count == len(words) or words[count] not in command.commands:
            return words[:count], None
        command = command.commands[words[count]]
        count += 1
    return words[:count], command


def is_whole(line):
    """Tell a command that a sentence shows whole from one that it only names."""
    words = shlex.split(line)[1:]
    if any(word.isupper() for word in words):
        return False  # a placeholder
    path, command = command_of(words)
    if command is None:
        return False
    try:
        command.make_context(" ".join(path), words[len(path) :])
    except Exception:  # an argument is missing
        return False
    return len(words) > len(path)


def commands_of(page):
    """Return the commands of a page, each once."""
    named = [line for line in named_commands(page) if is_whole(line)]
    return list(dict.fromkeys([*shown_commands(page), *named]))


def reduced(line):
    """Return the words of a command that is small enough for a test."""
    for words, others in INSTEAD.items():
        line = line.replace(words, others)
    words = shlex.split(line)[1:]
    path, _ = command_of(words)
    name = " ".join(path)
    marks = [mark for mark in ("--learn", "--scene") if mark in words]
    added = REDUCED.get(" ".join([name, *marks[:1]]), "").split()
    if "--divisor" in words and "--preview" in added:
        added.remove("--preview")
    if name == "calibrate run" and "--divisor" not in words:
        added = ["--preview", *added]
    return [*words, *(word for word in added if word != "--preview" or word not in words)]


def make_given(words, folder):
    """Write what a command reads and nothing before it has written."""
    written = {words[k + 1] for k, word in enumerate(words) if word in ("--out", "--plot")}
    for word in words:
        word = word.rpartition("|")[2].strip()  # a decoder behind a set
        if word.partition(":")[0].endswith(".py"):
            word = word.partition(":")[0]
        path = folder / word
        if word in GIVEN and word not in written and not path.exists():
            path.parent.mkdir(exist_ok=True, parents=True)
            GIVEN[word](path)


def as_a_shell(word):
    """Return the files that a word with a * stands for, or the word."""
    return (sorted(glob.glob(word)) if "*" in word else []) or [word]


def photograph(session):
    """Take photographs of a session's pictures by a camera that sees the panel and no more."""
    shutil.copytree(session / "patterns", session / "photographs")


CASES = [
    pytest.param(
        page,
        id=str(page.relative_to(ROOT)),
        # An experiment takes minutes where other tests take turns with it.
        marks=() if page.name in QUICK else (pytest.mark.slow, pytest.mark.timeout(3600)),
    )
    for page in PAGES
    if commands_of(page)
]


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A folder that has what the repository has, and the experiments of the thesis run once."""
    monkeypatch.chdir(tmp_path)
    for name in ("scenes", "tests/claims", "docs/examples"):  # a claim's scene stays in its folder
        shutil.copytree(ROOT / name, tmp_path / name)
    monkeypatch.setattr(bench, "runner", lambda name: functools.partial(experiment, name))
    return tmp_path


RUNNER = bench.runner


@functools.cache
def outcome_of(name, seed):
    return RUNNER(name)(preview=True, seed=seed)


def experiment(name, *, preview, seed, on_progress=None):
    assert preview
    return outcome_of(name, seed)


@pytest.mark.parametrize("page", CASES)
def test_the_commands_of_a_page_run(page, workplace):
    for line in commands_of(page):
        words = reduced(line)
        make_given(words, workplace)
        outcome = run_cli(*(path for word in words for path in as_a_shell(word)))
        # A claim or an acceptance may fail or be undecided.
        expected = (0, 1, 3) if words[0] in ("check", "accept") else (0,)
        if "--learn" in words and importlib.util.find_spec("torch") is None:
            expected = (2,)  # which says how to get it
        assert outcome.status in expected, f"{line}\n{outcome.err}"
        if words[:2] == ["patterns", "write"]:
            photograph(workplace / words[words.index("--out") + 1])


def test_the_tables_name_what_pages_show():
    lines = [line for page in PAGES for line in commands_of(page)]
    assert len(lines) > 80
    assert all(any(words in line for line in lines) for words in INSTEAD)
    assert all(any(word in " ".join(reduced(line)) for line in lines) for word in GIVEN)
