"""Fringes multiplexed into one frame, in views whose places are known."""

import numpy as np
import pytest
from scenes_small import small
from scipy.ndimage import binary_erosion, map_coordinates
from stages import capture, ground_truth, trace

from slbench.core.errors import InputError
from slbench.patterns import NoiseModel, PatternSequence, decode
from slbench.patterns.codes.spatial.composite import CompositeFringes

PANEL = (512, 480)
NOISE = NoiseModel(read_dn=1.0, step_dn=0.0)


def places(scale=1.1):
    """Panel places that a tilted plane with a bump on it shows: depth moves the column alone."""
    y, x = np.mgrid[0:360, 0:420]
    bump = 6 * np.exp(-((x - 200) ** 2 + (y - 180) ** 2) / (2 * 30**2))
    return 40 + x + 0.1 * y + bump, 30 + scale * y + 0.0 * x


def view(text, axis="u", scale=1.1, blur=0.0):
    """A sequence, its frames at those places, and the places along the axis."""
    u, v = places(scale)
    panel = PANEL if axis == "u" else PANEL[::-1]
    sequence = PatternSequence.parse(text, panel, axes=axis)
    frames = []
    for image in sequence.images():
        frames.append(map_coordinates(image if axis == "u" else image.T, [v, u], order=3))
    dn = 20 + 200 * np.array(frames)
    return sequence, dn if axis == "u" else dn.transpose(0, 2, 1), u if axis == "u" else u.T


@pytest.mark.parametrize("axis", "uv")
@pytest.mark.parametrize("scale", [0.9, 1.1, 1.3])
def test_one_frame_gives_the_place(axis, scale):
    sequence, frames, true = view("1@3+composite16", axis, scale)
    found = decode(frames.copy(), sequence, noise=NOISE)
    assert found.mask.mean() > 0.75  # a window's length at either end
    error = found.coordinate[axis] - true
    # Interpolation between the panel's pixels bends fine carriers: 0.5 % of a fringe of 32 px.
    assert np.nanstd(error) < 0.2
    assert np.nanmax(np.abs(error)) < 1.0


def test_two_frames_are_a_whole_sequence():
    sequence, frames, true = view("composite1+composite16")
    assert sequence.n_frames == 2
    found = decode(frames.copy(), sequence, noise=NOISE)
    error = (found.coordinate["u"] - true)[found.mask]
    assert found.mask.mean() > 0.5
    assert np.mean(np.abs(error) < 2.0) > 0.95


def test_the_predicted_deviation_is_the_measured_one():
    sequence, clean, _ = view("1@3+composite16")
    without = decode(clean.copy(), sequence, noise=NOISE).coordinate["u"]
    pulls = []
    for seed in range(3):
        noisy = clean + np.random.default_rng(seed).normal(0.0, 1.0, clean.shape)
        found = decode(noisy, sequence, noise=NOISE)
        pulls.append((found.coordinate["u"] - without) / found.sigma["u"])
    # 3 x 130,000 pixels, of which some 14 along a line share their noise: 0.5 %.
    assert np.nanstd(pulls) == pytest.approx(1.0, rel=0.05)


def test_a_rendered_plane_is_decoded():
    scene = small("plane", "gray+composite16", divisor=1)
    sequence = scene.sequence
    light, truth = trace(scene), ground_truth(scene)
    found = capture(scene, light, noise=False).decode()
    # Where a surface ends its carriers do: within a window's length, 38 px, amplitudes are wrong.
    inside = binary_erosion(truth.smooth(), iterations=40)
    error = (found.coordinate["u"] - truth.panel[..., 0])[inside & found.mask]
    assert sequence.n_frames == 21
    assert (inside & found.mask).sum() > 0.9 * inside.sum()
    assert np.quantile(np.abs(error), 0.9) < 0.5


def test_text_and_table_are_read_back():
    for axis in "uv":
        sequence = PatternSequence.parse("1@4+composite16", (640, 640), axes=axis)
        assert sequence.name == "1@4+composite16"
        assert PatternSequence.from_dict(sequence.to_dict()) == sequence
    own = CompositeFringes(16, shifts=4, carriers=100)
    assert own.word == "composite16(4 carriers up to 100)"


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: CompositeFringes(16, shifts=2), "shifts"),
        (lambda: CompositeFringes(16, carriers=4), "carriers"),
        (lambda: PatternSequence((512, 80), (CompositeFringes(16),)), "at most 26"),
        (lambda: PatternSequence((40, 480), (CompositeFringes(16),)), "at most 13"),
    ],
)
def test_bad_input_is_refused(make, word):
    with pytest.raises(InputError, match=word):
        make()


def test_pictures_without_carriers_are_masked():
    sequence, frames, _ = view("1@3+composite16")
    flat = np.full_like(frames, 100.0)
    assert not decode(flat, sequence, noise=NOISE).mask.any()
    assert not decode(flat[:, :8, :9].copy(), sequence, noise=NOISE).mask.any()
