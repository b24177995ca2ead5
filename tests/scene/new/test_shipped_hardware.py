"""Shipped hardware files: each loads, states its sources, and scans."""

import re
import tomllib

import numpy as np
import pytest
import tomli_w

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.detector.emva1288 import Detector
from slbench.scene.devices import datasheet
from slbench.scene.file import load_scene
from slbench.scene.new.hardware import find_hardware, shipped_hardware
from slbench.simulate.scan import scan

FILES = {one.name: one for one in shipped_hardware()}
DEVICES = [name for name, one in FILES.items() if one.kind != "rig"]
CAMERAS = [name for name, one in FILES.items() if one.kind == "camera"]
PROJECTORS = [name for name, one in FILES.items() if one.kind == "projector"]
#: What names a source, or says that there is none.
SHEETS = re.compile(
    r"\b(?:Basler|FLIR|Allied Vision|Raspberry Pi|TI|Epson|EMVA 1288|MATRIX VISION|ViALUX|Visitech"
    r"|mcSIM|Measured|thesis)\b"
)
UNCONFIRMED = "not confirmed: from memory of the sheet"
NO_SHEET = re.compile(f"derived|typical|as above|{UNCONFIRMED}")
#: By what the inches of a DMD, which TI rounds to a tenth or to five hundredths, are off at most.
DMD_INCH = 0.0125
LINE = re.compile(r"^(\w+) = ([^#]*?)\s*(?:# (.*))?$")


def scene_file(folder, camera, projector):
    """Write a scene of two files, with lenses where they have none."""
    lens = {"lens_mm": 25.0, "lens_f_number": 4.0}
    content = {
        "extends": [camera, projector],
        "name": "shipped",
        "camera": lens | {"focus_distance_mm": 400.0},
        "projector": {},
        "rig": {
            "camera": {"position_mm": [0.0, 0.0, 400.0]},
            "projector": {"position_mm": [150.0, 0.0, 400.0]},
        },
        "objects": [{"artefact": "plane", "material": "matt-white-spray"}],
        "patterns": {"sequence": "1,8", "shifts": 8, "axes": "u"},  # a gamma has harmonics
    }
    if "throw_ratio" not in FILES[projector].content["projector"]:
        content["projector"] = {"throw_ratio": 1.4}
    (folder / "shipped.toml").write_text(tomli_w.dumps(content))
    return folder / "shipped.toml"


def test_a_dozen_cameras_and_some_projectors_are_shipped():
    assert len(CAMERAS) >= 12
    assert len(PROJECTORS) >= 8
    assert {"hardware/prosilica-ge680c", "hardware/adimec-q-4a180"} <= set(CAMERAS)
    assert "hardware/ti-light-commander" in PROJECTORS


@pytest.mark.parametrize("name", DEVICES)
def test_every_number_has_its_source(name):
    text = resources.find("scenes", name).read_text(encoding="utf-8")
    assert len(FILES[name].title) > 20
    assert text.isascii()
    head = text.partition("\n\n")[0]
    numbers = 0
    for line in text.splitlines():
        found = LINE.match(line)
        if found is None:
            assert not line or line.startswith(("#", "[")), line
            continue
        assert found[3], line
        sources = SHEETS.findall(found[3])
        assert sources or NO_SHEET.search(found[3]), line
        # The head says which document that is.
        assert all(f"{one}:" in head or f"{one}, " in head for one in {*sources} - {"thesis"}), line
        assert "not confirmed" not in line.replace(UNCONFIRMED, ""), line
        numbers += 1
    table = tomllib.loads(text)
    assert numbers == sum(len(one) for one in table.values())
    assert set(table) <= {"camera", "detector", "projector"}


@pytest.mark.parametrize("name", CAMERAS)
def test_decibels_are_worked_out(name):
    text = resources.find("scenes", name).read_text(encoding="utf-8")
    detector = FILES[name].content["detector"]
    full = re.search(r"full_well_e = .*?from ([\d.]+) dB of SNR", text)
    if full:  # rounded to three digits
        stated = datasheet.saturation_e(float(full[1]))
        assert detector["full_well_e"] == pytest.approx(stated, rel=5e-3)
    noise = re.search(r"read_noise_e = .*?from ([\d.]+) (dB|bit) of dynamic range", text)
    if noise:  # rounded to a tenth of an electron
        decibels = float(noise[1]) * (20.0 * np.log10(2.0) if noise[2] == "bit" else 1.0)
        stated = datasheet.dark_noise_e(detector["full_well_e"], decibels)
        assert detector["read_noise_e"] == pytest.approx(stated, abs=0.06)


@pytest.mark.parametrize(
    ("name", "active_mm"),
    [
        # Active areas: of the DLP5500 by TI's data sheet, the others are not confirmed.
        ("ti-lightcrafter", (6.5718, 3.699)),
        ("ti-lightcrafter-4500", (9.855, 6.1614)),
        ("ti-dlp2010", (4.6116, 2.592)),
        ("ti-dlp3010", (6.912, 3.888)),
        ("ti-dlp4710", (10.368, 5.832)),
        ("ti-dlp6500", (14.5152, 8.1648)),
        ("ti-dlp9000", (19.3536, 12.096)),
        ("ti-light-commander", (11.059, 8.294)),
    ],
)
def test_panels_have_the_size_of_their_data_sheets(tmp_path, name, active_mm):
    path = scene_file(tmp_path, "hardware/basler-aca1920-40um", f"hardware/{name}")
    projector = load_scene(path).rig.projector
    size = np.multiply((projector.width, projector.height), projector.pitch_mm)
    np.testing.assert_allclose(size, active_mm, rtol=2e-3)


@pytest.mark.parametrize("name", [one for one in PROJECTORS if "/ti-" in one])
def test_the_diagonals_of_micromirrors_are_those_of_their_names(name):
    file = FILES[name]
    table = file.content["projector"]
    pitch, layout = table.get("micromirror_um"), table.get("micromirrors", "orthogonal")
    pitches = datasheet.micromirror_pitches_um(pitch or table["pitch_um"], layout)
    inch = float(np.hypot(*np.multiply(table["resolution_px"], pitches))) / 25.4e3
    stated = re.search(r": (?:DLP\d+, )?([\d.]+) inch", file.title)
    assert inch == pytest.approx(float(stated[1]), abs=DMD_INCH)
    # A micromirror's turn t separates cones of light of f / (2 sin t).
    text = resources.find("scenes", name).read_text(encoding="utf-8")
    turn = re.search(r"^f_number = .*?(\d+) degrees.*1 / \(2 sin (\d+)\)", text, re.MULTILINE)
    assert (turn is None) == ("f_number" not in table)
    if turn:
        assert turn[1] == turn[2]
        expected = 0.5 / np.sin(np.radians(float(turn[1])))
        assert table["f_number"] == pytest.approx(expected, abs=0.05)


def test_what_is_not_confirmed_is_known():
    doubtful = {name: one.unconfirmed for name, one in FILES.items() if one.unconfirmed}
    assert doubtful == {
        "hardware/epson-eh-tw9400": (
            "projector.panel_inch",
            "projector.lens_f_number",
            "projector.lens_shift_percent",
        ),
        "hardware/flir-bfs-u3-122s6m": ("detector.bit_depth",),
        "hardware/ti-dlp2010": ("projector.micromirror_um",),
        "hardware/ti-dlp3010": ("projector.f_number",),
        "hardware/ti-dlp9000": ("projector.f_number",),
        "hardware/ti-lightcrafter": ("projector.f_number",),
        "hardware/ti-lightcrafter-4500": ("projector.flux_lm",),
    }


def test_the_diagonals_of_sensors_are_those_of_their_formats():
    stated = 0
    for name in CAMERAS:
        file = FILES[name]
        found = re.search(r"([\d/.]+) inch", file.title)
        if found:
            stated += 1
            size, pitch = (
                file.content["camera"]["resolution_px"],
                file.content["camera"]["pitch_um"],
            )
            diagonal = 1e-3 * pitch * float(np.hypot(*size))
            # Sensors of one format differ by some 3 %; the default is a little less than all of it.
            assert diagonal == pytest.approx(datasheet.format_diagonal_mm(found[1]), rel=0.05), name
    assert stated == len(CAMERAS) - 1  # the thesis has no format of the Adimec's


@pytest.mark.parametrize(
    ("camera", "projector"),
    [(name, "hardware/ti-lightcrafter") for name in CAMERAS]
    + [("hardware/basler-aca1920-40um", name) for name in PROJECTORS],
)
@pytest.mark.filterwarnings("ignore:scene shipped. sampling")  # few samples are enough here
def test_each_device_scans(tmp_path, camera, projector):
    loaded = load_scene(scene_file(tmp_path, camera, projector))
    own = FILES[camera].content["detector"]
    assert isinstance(loaded.detector, Detector)
    assert loaded.detector.full_well_e == own["full_well_e"]
    small = loaded.coarser(-(-loaded.rig.camera.width // 64), 4)
    result = scan(small, seed=0)
    assert result.truth.lit.sum() > 500  # of some 64 x 40 pixels
    # A plane: nearly every lit pixel has a point.
    assert np.isfinite(result.cloud.points).all()
    assert len(result.cloud.points) > 0.9 * result.truth.lit.sum()


def test_hardware_is_found_by_its_name_or_its_path(tmp_path):
    found = find_hardware("flir-bfs-u3-51s5m", "camera", tmp_path, "--camera")
    assert found == find_hardware("hardware/flir-bfs-u3-51s5m", "camera", tmp_path, "--camera")
    (tmp_path / "sub").mkdir()
    mine = tmp_path / "sub" / "mine.toml"
    mine.write_text("[camera]\nresolution_px = [64, 48]\npitch_um = 10.0\n")
    own = find_hardware(str(mine), "camera", tmp_path, "--camera")
    assert (own.name, own.title, own.unconfirmed) == ("sub/mine.toml", "mine", ())
    mine.write_text("[camera]\npitch_um = 3.45  # not confirmed: of a dealer\nblur_px = 1.0\n")
    own = find_hardware(str(mine), "camera", tmp_path, "--camera")
    assert own.unconfirmed == ("camera.pitch_um",)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("flir-bfs-u3-51s5", "did you mean 'flir-bfs-u3-51s5m'"),
        ("ti-dlp2010", "a file with a table [camera], got ti-dlp2010 with [projector]"),
        ("macro-ch6", "a camera alone (copy a whole rig by slbench scene copy), got macro-ch6"),
        ("none.toml", "expected a file, got none.toml, which is none"),
        ("../outside.toml", "a file in the folder of the scene"),
        ("../../etc/passwd", "a shipped camera"),
    ],
)
def test_what_is_no_camera(tmp_path, monkeypatch, name, words):
    folder = tmp_path / "scenes"
    folder.mkdir()
    (tmp_path / "outside.toml").write_text("[camera]\n")
    monkeypatch.chdir(folder)
    with pytest.raises(InputError) as caught:
        find_hardware(name, "camera", folder, "--camera")
    assert str(caught.value).startswith("--camera: ")
    assert words in str(caught.value)
