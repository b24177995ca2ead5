"""Pictures for a real projector, photographed by one whose response and camera are known."""

import cv2
import numpy as np
import pytest

from slbench.capture.capture import Capture
from slbench.capture.shown import PHOTOGRAPHS, pictures, write_pictures
from slbench.core.errors import InputError
from slbench.core.io import read_toml
from slbench.patterns import PatternSequence, Response

SEQUENCE = PatternSequence.parse("gray+16@4", (192, 120))


def photographed(folder, gamma):
    """Put what a camera of 8 bit sees of a panel one to one beside the pictures."""
    (folder / PHOTOGRAPHS).mkdir()
    for path in sorted((folder / "patterns").glob("*.png")):
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        light = (picture / float(np.iinfo(picture.dtype).max)) ** gamma
        seen = np.rint(20.0 + 200.0 * light).astype(np.uint8)
        cv2.imwrite(str(folder / PHOTOGRAPHS / path.name), seen)


@pytest.mark.parametrize(("bits", "gamma", "border"), [(8, 1.0, 0), (8, 2.2, 6), (10, 2.2, 0)])
def test_photographs_of_the_pictures_decode_to_the_panel(tmp_path, bits, gamma, border):
    folder = tmp_path / "session"
    write_pictures(SEQUENCE, folder, bits=bits, response=Response(gamma), border_px=border)
    photographed(folder, gamma)
    phase = Capture.load(folder).decode()
    inside = np.zeros((120, 192), bool)
    inside[border : 120 - border, border : 192 - border] = True
    np.testing.assert_array_equal(phase.mask, inside)
    columns = np.broadcast_to(np.arange(192.0), (120, 192))
    # Fringes of 12 px in 100 DN: rounding of camera and projector to 8 bit each.
    np.testing.assert_allclose(phase.coordinate["u"][inside], columns[inside], atol=0.03)


def test_pictures_that_are_not_corrected_are_seen_as_they_are():
    """Without its inverse a gamma of 2.2 would show: the correction is what the test above sees."""
    linear, corrected = (
        np.array(list(pictures(SEQUENCE, response=Response(gamma))))[-4:] / 255.0
        for gamma in (1.0, 2.2)
    )
    assert np.abs(corrected - linear).max() > 0.1
    np.testing.assert_allclose(corrected**2.2, linear, atol=0.01)


def test_levels_are_those_of_the_projector():
    (first, *_) = pictures(PatternSequence.parse("1,8@3", (192, 120)), bits=4)
    assert first.dtype == np.uint8
    assert set(np.unique(first)) <= set(np.rint(np.arange(16) * 255 / 15).astype(int))
    (first, *_) = pictures(SEQUENCE, bits=12)
    assert first.dtype == np.uint16


def test_the_manifest_names_photographs_and_patterns(tmp_path):
    write_pictures(SEQUENCE, tmp_path / "out")
    manifest = read_toml(tmp_path / "out" / "capture.toml")
    assert manifest["frames"][-1] == f"{PHOTOGRAPHS}/{SEQUENCE.n_frames - 1:03d}.png"
    assert PatternSequence.from_dict(manifest["patterns"]) == SEQUENCE
    # Photographs beside them are somebody else's, and stay.
    photographed(tmp_path / "out", 1.0)
    write_pictures(SEQUENCE, tmp_path / "out", response=Response(2.0))
    assert len(list((tmp_path / "out" / PHOTOGRAPHS).iterdir())) == SEQUENCE.n_frames


def test_a_border_that_leaves_nothing_is_refused(tmp_path):
    with pytest.raises(InputError, match="border_px: expected less than half of 120 px, got 60"):
        write_pictures(SEQUENCE, tmp_path / "out", border_px=60)
    assert not (tmp_path / "out").exists()
