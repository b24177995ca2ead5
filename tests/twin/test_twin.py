"""Twins of simulated scanners: of what they do not know, and of what they have no word for."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.calibration.characterise.hardware import write_hardware
from slbench.calibration.characterise.measure import characterise
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import read_exr
from slbench.rig import Pose
from slbench.scene import load_scene
from slbench.scene.file import load_scene as load
from slbench.simulate.scan import scan
from slbench.twin import TwinObject, make_twin, write_twin

PATTERNS = "patterns.sequence=white+white+white+white+black+black+black+black+1,8@8+40@8+8@8"
#: What the twin is not told.
UNKNOWN = [
    "projector.blur_px=0.8",
    "light.ambient_w_per_m2=2",
    "camera.shading=[0.02,0,-0.2,0,-0.1]",
]


def photographed(*changes, name="plane", seed=1, patterns=PATTERNS):
    """Return a capture with a rig that knows nothing of light and blur."""
    scene = load_scene(name, preview=True, changes=[patterns, *UNKNOWN, *changes])
    made = scan(scene, seed=seed, samples=64, score=False).capture
    rig = scene.rig
    bare = rig.having(
        camera=replace(rig.camera, shading=()),
        projector=replace(rig.projector, blur_px=0.0, gamma=1.0),
    )
    return replace(made, rig=bare, noise=None)


def hardware(capture, folder):
    """Characterise a scanner by its own capture."""
    path = folder / "hardware.toml"
    write_hardware(characterise({"capture": capture}), path)
    return path


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """A capture, its hardware, and its twin."""
    capture = photographed()
    path = hardware(capture, tmp_path_factory.mktemp("hardware"))
    return capture, path, make_twin(capture, [TwinObject(shape="plane")], hardware=path, seed=7)


def test_the_twin_of_a_scanner_predicts_frames_that_nothing_was_fitted_to(known) -> None:
    _, _, twin = known
    likeness = twin.likeness
    assert likeness.misfits() == []
    assert likeness.noise.ratio == pytest.approx(1.0, abs=0.05)
    held = [one for one in likeness.contrasts if one.held_out]
    assert held
    assert all(one.ratio == pytest.approx(1.0, abs=0.02) for one in held)
    # Noise, fixed pattern and sampling explain what is left, but for a tenth.
    assert likeness.chi_square == pytest.approx(1.0, abs=0.2)
    one, other = likeness.points.rms_mm()
    assert one == pytest.approx(other, rel=0.05)


def test_the_twin_finds_what_it_was_not_told(known) -> None:
    _, _, twin = known
    fitted = twin.to_dict()["fitted"]
    assert fitted["projector_blur_px"] == pytest.approx(0.8, abs=0.05)
    # The hardware's black level has the stray light of black frames in it, 13 DN.
    assert fitted["black_dn"] == pytest.approx(2.0, abs=0.5)
    assert fitted["ambient_w_per_m2"] == pytest.approx(2.0, rel=0.05)
    # Relative to the middle, on the part of the picture that is lit.
    grid = twin.scene.rig.camera.pixel_grid()[40:-40:20, 100:-100:20]
    shaded = load_scene("plane", preview=True, changes=UNKNOWN).rig.camera
    ratio = twin.scene.rig.camera.relative_illumination(grid) / shaded.relative_illumination(grid)
    assert ratio / ratio.mean() == pytest.approx(np.ones_like(ratio), abs=0.02)


def test_a_written_twin_is_a_scene_that_scans_alike(known, tmp_path) -> None:
    _, _, twin = known
    write_twin(twin, tmp_path / "twin")
    maps = read_exr(tmp_path / "twin" / "differences.exr")
    assert np.nanmean(maps["chi_square"]) == pytest.approx(twin.likeness.chi_square, rel=1e-5)
    seen = np.isfinite(maps["photographed_mm"])
    assert np.nanstd(maps["photographed_mm"][seen]) == pytest.approx(
        np.nanstd(maps["simulated_mm"][seen]), rel=0.05
    )
    again = load(tmp_path / "twin" / "twin.toml")
    made = scan(again, seed=3, score=False)
    lit = twin.simulated.frames[0] > 100
    mean = made.capture.frames[0][lit].mean(dtype=float)
    assert mean == pytest.approx(twin.capture.frames[0][lit].mean(dtype=float), rel=0.01)
    # An older twin is replaced, what is somebody else's is not.
    write_twin(twin, tmp_path / "twin")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "twin.toml").write_text("mine")
    with pytest.raises(InputError, match=r"twin\.toml"):
        write_twin(twin, tmp_path / "mine")


def test_another_capture_is_judged_by_and_not_fitted_to(known) -> None:
    capture, path, _ = known
    other = photographed(patterns="patterns.sequence=1,16,32@6", seed=2)
    twin = make_twin(capture, [TwinObject(shape="plane")], hardware=path, held_out=[other])
    count = len(capture.frames)
    assert [one.held_out for one in twin.likeness.frames] == [
        k >= count for k in range(count + len(other.frames))
    ]
    judged = {one.fringes: one.ratio for one in twin.likeness.contrasts if one.held_out}
    assert judged == {n: pytest.approx(1.0, abs=0.02) for n in (1.0, 16.0, 32.0)}
    assert twin.scene.sequence.n_frames == count


def test_a_response_that_the_hardware_does_not_know_does_not_fit(known) -> None:
    _, path, _ = known
    bent = photographed("projector.gamma=1.3")
    twin = make_twin(bent, [TwinObject(shape="plane")], hardware=path)
    assert any("held-out frames differ" in one for one in twin.likeness.misfits())


def test_noise_of_another_camera_does_not_fit(known, tmp_path) -> None:
    capture, path, _ = known
    gain = float(path.read_text().split("gain_e_per_dn = ")[1].split()[0])
    text = path.read_text().replace(f"gain_e_per_dn = {gain:g}", f"gain_e_per_dn = {0.7 * gain:g}")
    other = tmp_path / "other.toml"
    other.write_text(text)
    twin = make_twin(capture, [TwinObject(shape="plane")], hardware=other)
    # Shot noise in digital numbers goes as the root of 1 / 0.7, read noise as 1 / 0.7.
    assert 1.195 < twin.likeness.noise.ratio < 1.43
    assert any("the twin's noise is 1." in one for one in twin.likeness.misfits())


def test_a_rig_that_is_off_by_three_millimetres_does_not_fit(known) -> None:
    capture, path, _ = known
    projector = capture.rig.projector
    place = replace(projector.pose, position=projector.pose.position + np.array([3.0, 0.0, 0.0]))
    rig = capture.rig.having(projector=projector.posed(place))
    twin = make_twin(replace(capture, rig=rig), [TwinObject(shape="plane")], hardware=path)
    # Noise hides it pixel by pixel, as a plane stays one to some micrometres; means do not.
    assert any("points are off" in one for one in twin.likeness.misfits())


def test_another_shape_does_not_fit(known) -> None:
    _, path, _ = known
    bowl = photographed(name="bowl")
    with pytest.warns(InputWarning, match="points lie on no object"):
        twin = make_twin(bowl, [TwinObject(shape="plane")], hardware=path)
    assert any("points are off" in one for one in twin.likeness.misfits())


@pytest.mark.slow  # at the outlines it is rendered again and again
def test_a_twin_of_two_objects(known) -> None:
    made = photographed(name="step-block")
    objects = [
        TwinObject(shape="step-block-5", start=Pose(np.eye(3), np.array([1.0, -1.0, 0.5]))),
        TwinObject(shape="plane", material="dark-stage"),
    ]
    _, path, _ = known
    twin = make_twin(made, objects, hardware=path, bounces=0)
    assert [place.pose.position[2] for place in twin.places] == pytest.approx([0.0, -5.0], abs=5e-3)
    assert twin.likeness.noise.ratio == pytest.approx(1.0, abs=0.05)
    assert twin.likeness.misfits() == []


def test_a_data_sheet_is_hardware_too(known, tmp_path) -> None:
    capture, _, _ = known
    path = tmp_path / "sheet.toml"
    # 16,000 electrons are 42 dB, and 12 of them 62.5 dB below; the rig has the rest.
    path.write_text(
        "[camera]\nresolution_px = [320, 240]\nlens_mm = 16.0\nnatural_vignetting = true\n"
        "[detector]\nbit_depth = 8\nsnr_max_db = 42.0\ndynamic_range_db = 62.5\noffset_dn = 2.0"
    )
    twin = make_twin(capture, [TwinObject(shape="plane")], hardware=path, samples=16)
    assert twin.likeness.noise.ratio == pytest.approx(1.0, abs=0.05)
    write_twin(twin, tmp_path / "twin")
    assert load(tmp_path / "twin" / "twin.toml").detector == twin.scene.detector


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[camera]\nresolution_px = [640, 480]", r"camera.resolution_px: expected \[320, 240\]"),
        ("[detector]\nbit_depth = 12\ngain_e_per_dn = 10.0", "detector.bit_depth: expected 8"),
        ("[detector]\ngian_e_per_dn = 10.0", "gian_e_per_dn"),
        ("[projector]\nblurr_px = 1.0", "blurr_px"),
    ],
)
def test_hardware_of_another_camera_is_refused(known, tmp_path, text, expected) -> None:
    capture, _, _ = known
    path = tmp_path / "hardware.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=expected):
        make_twin(capture, [TwinObject(shape="plane")], hardware=path)


def test_captures_that_cannot_have_a_twin_are_refused(known) -> None:
    capture, _, _ = known
    plane = [TwinObject(shape="plane")]
    with pytest.raises(InputError, match="a capture with its rig"):
        make_twin(replace(capture, rig=None), plane)
    with pytest.raises(InputError, match="the unit of the mesh file"):
        make_twin(capture, [TwinObject(shape="part.stl")])
    with pytest.raises(InputError, match="step-block-5"):
        make_twin(capture, [TwinObject(shape="step-blok-5")])
    small = replace(capture, frames=capture.frames[:, ::2, ::2], rig=None)
    with pytest.raises(InputError, match="frames of"):
        make_twin(capture, plane, held_out=[small])
