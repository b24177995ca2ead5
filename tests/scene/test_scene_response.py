"""A projector's measured response as a key of a scene."""

import csv

import numpy as np
import pytest
from scenes_small import small, transport_of

from slbench.calibration.characterise.hardware import write_hardware
from slbench.calibration.characterise.measure import characterise
from slbench.core.errors import InputError, InputWarning
from slbench.patterns import Flat, PatternSequence, Response
from slbench.rig.opencv import read_rig, write_rig
from slbench.scene.file import load_scene
from slbench.simulate.expose import capture

V = np.linspace(0.0, 1.0, 65)
#: No gamma comes near it.
S_CURVE = tuple(zip(V.tolist(), (3 * V**2 - 2 * V**3 + 0.1 * V).tolist(), strict=True))
ROWS = [list(pair) for pair in S_CURVE]


def write_scene(folder, response, name="mine", base="plane", more=""):
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.toml"
    text = f'extends = "{base}"\nname = "{name}"\n[projector]\nresponse = {response}\n{more}'
    path.write_text(text)
    return path


def write_curve(path):
    path.parent.mkdir(exist_ok=True)
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([("value", "radiance"), *S_CURVE])


def test_a_curve_stands_in_the_scene_or_in_a_file_beside_it(tmp_path):
    assert load_scene(write_scene(tmp_path, ROWS)).rig.projector.curve == S_CURVE
    write_curve(tmp_path / "parts" / "curve.csv")
    write_scene(tmp_path / "parts", '"curve.csv"', "base")
    path = tmp_path / "other.toml"
    # The file is relative to the scene that names it.
    path.write_text('extends = "parts/base.toml"\nname = "other"\n')
    scene = load_scene(path)
    assert scene.rig.projector.curve == S_CURVE
    assert scene.specification["projector"]["response"] == ROWS
    changed = load_scene(path, changes={"projector.response": [[0, 0], [1, 2]]})
    assert changed.rig.projector.curve == ((0.0, 0.0), (1.0, 2.0))
    assert load_scene(path, changes={"projector.response": None}).rig.projector.curve is None


@pytest.mark.parametrize(
    ("response", "said"),
    [
        ("[[0, 0], [1, 0]]", "radiances that grow"),
        ("[[0, 0], [0.5, 1]]", "from 0 to 1"),
        ("[]", "two pairs"),
        ("[[0, 0]]", "two pairs"),
        ('"none.csv"', "projector.response"),
        ('"../curve.csv"', "projector.response"),
        ("2.2", "projector.response"),
    ],
)
def test_another_curve_is_refused(tmp_path, response, said):
    with pytest.raises(InputError, match=rf"mine\.toml.*{said}"):
        load_scene(write_scene(tmp_path / "scenes", response))


def test_a_gamma_beside_a_curve_is_questioned(tmp_path):
    path = write_scene(tmp_path, ROWS, more="gamma = 2.2\n")
    with pytest.warns(InputWarning, match=r"projector\.gamma: not used"):
        load_scene(path)


def test_a_rig_file_keeps_the_curve(tmp_path):
    rig = load_scene(write_scene(tmp_path, ROWS)).rig
    write_rig(tmp_path / "rig.yaml", rig)
    assert read_rig(tmp_path / "rig.yaml").projector.curve == S_CURVE
    text = (tmp_path / "rig.yaml").read_text()
    write_rig(tmp_path / "rig.yaml", rig.having(projector=rig.projector.linear()))
    assert "response_projector" in text
    assert "response_projector" not in (tmp_path / "rig.yaml").read_text()
    scene = (
        'name = "filed"\n[rig]\nfile = "rig.yaml"\n[projector]\nresponse = [[0, 0], [1, 3]]\n'
        '[[objects]]\nartefact = "plane"\n'
    )
    (tmp_path / "filed.toml").write_text(scene)
    assert load_scene(tmp_path / "filed.toml").rig.projector.curve == ((0.0, 0.0), (1.0, 3.0))


def test_a_curve_that_is_put_in_comes_out_and_goes_into_a_scene(tmp_path):
    """Scanned flat frames and fringes; the scene of what was measured has the same light."""
    scene = small("plane")
    rig = scene.rig.having(
        projector=load_scene(write_scene(tmp_path, ROWS)).rig.projector  # with the same pixels
    )
    levels = np.linspace(0.0, 1.0, 17)
    ramp = PatternSequence(scene.sequence.panel, tuple(Flat(level) for level in levels))
    fringes = PatternSequence.parse("2@16", scene.sequence.panel)
    for name, sequence in (("ramp", ramp), ("fringes", fringes)):
        one = capture(transport_of("plane"), sequence, rig, scene.detector, scene.exposure, seed=1)
        found = characterise({name: one})
        write_hardware(found, tmp_path / f"{name}.toml")
        path = tmp_path / f"of-{name}.toml"
        path.write_text(f'extends = ["plane", "{name}.toml"]\nname = "again"\n')
        again = load_scene(path).rig.projector
        assert again.curve is not None
        values = np.linspace(0.0, 1.0, 101)
        # Straight between 17 levels: a curve of slope 6 (1 - 2 v) bends by 6 / 8 / 16^2 = 0.003 of
        # white; noise of 19,200 pixels is less than 0.0005, and so is rounding of the panel's
        # 256 levels in the mean.
        expected = Response(curve=S_CURVE).light(values)
        np.testing.assert_allclose(again.response.light(values), expected, atol=0.004)


def test_light_is_that_of_the_curve(tmp_path):
    scene = small("plane")
    projector = load_scene(write_scene(tmp_path, ROWS)).rig.projector
    sequence = PatternSequence(scene.sequence.panel, (Flat(1.0), Flat(51 / 255)))
    (white, grey) = capture(
        transport_of("plane"), sequence, scene.rig.having(projector=projector), scene.detector,
        scene.exposure, noise=False,
    ).frames - scene.detector.black_dn  # fmt: skip
    expected = Response(curve=S_CURVE).light(0.2)
    # Whole numbers of at most 200 DN, over thousands of pixels: far below half a DN in the mean.
    assert grey.mean() / white.mean() == pytest.approx(expected, abs=0.002)
