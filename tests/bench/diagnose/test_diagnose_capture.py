"""Causes put into simulated scans of a plate one at a time, and what is said of them.

What a cause makes is known without the diagnosis: a scan with an ideal detector and the cause
alone is decoded, and the coordinates' differences from the same scan without it are taken.
"""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import at, small
from stages import capture, shutter_for, trace

from slbench.bench.budget.sources import BOTTOMLESS_E
from slbench.bench.diagnose.capture import diagnose_capture
from slbench.bench.diagnose.shape import kind_of
from slbench.cloud.decoded import decode_capture
from slbench.core.errors import InputError, InputWarning
from slbench.detector import Detector
from slbench.rig import Pose
from slbench.scene.model import Exposure, Light

#: Four shifts, eight camera pixels and more a fringe.
PATTERNS = "1,4,16"
PERIOD = 640 / 16
#: Rounded finely: few grey values bend the dark fringes of a gamma.
NOISY = Detector(bit_depth=12)
QUIET = Detector(bit_depth=16, full_well_e=BOTTOMLESS_E, read_noise_e=0.0, prnu=0.0, dsnu_e=0.0)


@functools.cache
def scene(gamma=1.0, shifts=4):
    made = small("plane", PATTERNS, shifts, divisor=2)
    # Rounded panel values have harmonics as well, which scans with and without a gamma share.
    projector = replace(made.rig.projector, gamma=gamma, bit_depth=None)
    return replace(made, rig=made.rig.having(projector=projector))


@functools.cache
def light():
    return trace(scene(), seed=0)


def shots(made=None, *, seed=0, vibration=0.0, quiet=False, gains=(), more_noise=0.0):
    """Return a capture; `gains` are of the finest set's frames."""
    made = scene() if made is None else made
    exposure = Exposure(vibration_px=vibration)
    made = replace(made, exposure=exposure, detector=QUIET if quiet else NOISY)
    taken = capture(made, light(), seed=seed, shutter=shutter_for(made, light()))
    frames = taken.frames.astype(np.float64)
    if len(gains):
        black = taken.noise.offset_dn
        last = frames[-len(gains) :]
        last[:] = black + (last - black) * np.asarray(gains)[:, None, None]
    if more_noise:  # of the coarser sets, which number the fringes
        rng = np.random.default_rng(seed)
        coarse = frames[: -made.sequence.finest("u").frames.__len__()]
        coarse += rng.normal(0.0, more_noise, coarse.shape)
    if len(gains) or more_noise:
        top = 2**taken.bit_depth - 1
        frames = np.clip(np.rint(frames), 0, top).astype(taken.frames.dtype)
        taken = replace(taken, frames=frames)
    return taken


def diagnosed(taken, **options):
    return diagnose_capture(decode_capture(taken), **options)


def put_in_mm(found, with_it, without):
    """Return the RMS of what a cause makes of distances, less a plane over the image."""
    one, two = decode_capture(with_it), decode_capture(without)
    column, row = found.places.astype(int).T
    off = (one.phase.coordinate["u"] - two.phase.coordinate["u"])[row, column]
    normal = two.cloud.image(two.cloud.sensitivity[:, 0, 2])[row, column]
    design = np.stack([np.ones(len(row)), row, column], axis=1)
    off -= design @ np.linalg.lstsq(design, off, rcond=None)[0]
    return float(np.sqrt(np.mean((off * normal) ** 2)))


def ripples_mm(found):
    """Return the RMS of all ripples of the fringes."""
    kinds = ("response", "vibration", "unequal light", "indirect light")
    return np.sqrt(sum(found[name].mean_square_mm2 for name in kinds))


def names(found):
    return [cause.name for cause in found.named]


def test_a_clean_scan_has_no_cause_and_the_predicted_noise():
    found = diagnosed(shots())
    assert names(found) == []
    assert found["noise"].rms_mm == pytest.approx(found.predicted_mm, rel=0.1)
    assert found.share(found["noise"]) > 0.97
    assert "no systematic cause" in found.sentences()[0]


@pytest.mark.parametrize(
    ("cause", "options"),
    [
        ("response", {"made": 1.8}),
        ("vibration", {"vibration": 0.15}),
        ("unequal light", {"gains": (1.04, 0.98, 1.01, 0.96)}),
    ],
)
def test_one_cause_is_named_alone_with_the_size_that_was_put_in(cause, options):
    options = {k: scene(v) if k == "made" else v for k, v in options.items()}
    found = diagnosed(shots(**options))
    assert names(found) == [cause]
    expected = put_in_mm(found, shots(quiet=True, **options), shots(quiet=True))
    # 5 %: of some 30,000 points noise tells a ripple to 1 %, and there are small parts of others.
    assert ripples_mm(found) == pytest.approx(expected, rel=0.05)
    low, high = found.share_ci95(found[cause])
    assert low < found.share(found[cause]) < high
    assert found["noise"].rms_mm == pytest.approx(found.predicted_mm, rel=0.1)
    # Terms of one cause are a little like those of another: their products are not in the sum.
    assert sum(found.share(c) for c in found.causes if not c.far) == pytest.approx(1.0, abs=0.05)


def test_unequal_light_has_a_part_of_twice_the_fringes_that_is_not_named():
    found = diagnosed(shots(gains=(1.04, 0.98, 1.01, 0.96)))
    assert found["vibration"].note == "no more than unequal light makes"
    # By hand: 2 A / B times |sum g exp(i d)| and |sum g exp(2 i d)| over N, of phase.
    assert found["vibration"].rms_mm > found["unequal light"].rms_mm


def test_two_causes_are_both_named():
    found = diagnosed(shots(scene(1.8), vibration=0.15))
    assert sorted(names(found)) == ["response", "vibration"]
    together = shots(scene(1.8), vibration=0.15, quiet=True)
    assert ripples_mm(found) == pytest.approx(
        put_in_mm(found, together, shots(quiet=True)), rel=0.05
    )


def test_a_lens_that_was_calibrated_wrong_is_a_bowl():
    taken = shots()
    wrong = replace(taken.rig.projector, distortion=(0.08, 0.0, 0.0, 0.0))
    found = diagnosed(replace(taken, rig=taken.rig.having(projector=wrong)))
    assert names(found) == ["bowl"]
    # The points by both rigs, less a plane, are what the wrong one makes.
    right, bent = (
        decode_capture(replace(taken, rig=rig)).cloud.points
        for rig in (taken.rig, taken.rig.having(projector=wrong))
    )
    off = bent[:, 2] - right[:, 2]
    design = np.column_stack([np.ones(len(right)), right[:, :2]])
    off -= design @ np.linalg.lstsq(design, off, rcond=None)[0]
    # 15 %: the rim, where the lens bends most, is left out.
    assert found["bowl"].rms_mm == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.15)


def test_wrong_orders_are_steps_of_whole_fringes():
    decoded = decode_capture(shots(more_noise=600.0))
    found = diagnose_capture(decoded)
    assert names(found) == ["orders"]
    column, row = found.places.astype(int).T
    exact = decode_capture(shots(quiet=True)).phase.coordinate["u"]
    off = (decoded.phase.coordinate["u"] - exact)[row, column]
    share = np.mean(np.abs(off) > 0.5 * PERIOD)
    assert share > 0.001
    # The note has two digits.
    stated = float(found["orders"].note.split(" %")[0]) / 100.0
    assert stated == pytest.approx(share, rel=0.05)


def test_a_step_block_is_no_plane():
    block = small("step-block", PATTERNS, 4)
    taken = capture(block, trace(block, seed=0))
    with pytest.warns(InputWarning, match="% of the points are off the fitted plane"):
        assert "gross" in names(diagnosed(taken, shape="plane"))


def test_few_points_and_no_rig_are_refused():
    taken = shots()
    with pytest.raises(InputError, match="500 points"):
        diagnosed(taken, region=(100, 100, 20, 20))
    with pytest.raises(InputError, match="a capture with a rig"):
        diagnosed(replace(taken, rig=None))
    with pytest.raises(InputError, match="nearer to a plane"):
        diagnosed(taken, shape="sphere")


def test_a_ball_and_its_size():
    ball = small("sphere", PATTERNS, 4, divisor=2)
    decoded = decode_capture(capture(ball, trace(ball, seed=0)))
    found = diagnose_capture(decoded, region=(125, 75, 70, 70), diameter_mm=25.0)
    assert kind_of(found.shape) == "sphere"
    assert names(found) == []
    off = 2.0 * found.shape.radius - 25.0
    assert abs(off) < 4.0 * found.diameter_deviation_mm
    assert f"{1e6 * off / 25.0:+.0f} ppm" in "".join(found.sentences())


def test_light_of_another_place_is_indirect():
    """A bright spot shines on the plate, the less the further away: its fringes come with it."""

    def shone_on(taken):
        black = taken.noise.offset_dn
        spot = taken.frames[:, 120, 240].astype(np.float64) - black
        column = np.arange(taken.frames.shape[2])
        light = spot[:, None, None] * 0.05 * np.exp((column - 250.0) / 40.0)
        return replace(taken, frames=np.rint(taken.frames + light).astype(np.uint16))

    found = diagnosed(shone_on(shots()), region=(50, 20, 200, 200))  # the plate
    assert names(found) == ["indirect light"]
    assert found["unequal light"].note == "part of the indirect light's"
    expected = put_in_mm(found, shone_on(shots(quiet=True)), shots(quiet=True))
    # 15 %: a polynomial of second degree follows the decay, an exponential, no closer.
    assert ripples_mm(found) == pytest.approx(expected, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("albedo", "named"), [(0.8, True), (0.001, False)])
def test_a_wall_beside_the_plate_is_indirect_light(albedo, named):
    plate = scene()
    wall = at(plate.objects[0].artefact, albedo=albedo)
    upright = Pose(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), [30.0, 0.0, 0.0])
    both = (plate.objects[0], replace(wall, pose=upright))
    made = replace(plate, objects=both, light=Light(bounces=2), detector=QUIET, samples=64)
    light = trace(made, seed=0)
    decoded = decode_capture(capture(made, light, shutter=shutter_for(made, light)))
    x, _, z = decoded.cloud.points.T
    plate = decoded.cloud.pixels[(x < 27.0) & (np.abs(z) < 0.5)]
    (left, top), (right, bottom) = np.percentile(plate, (1.0, 99.0), axis=0).astype(int)
    found = diagnose_capture(decoded, region=(left, top, right - left, bottom - top))
    # Whether it is a hundredth of the errors depends on the renderer's noise.
    assert (found["indirect light"].p < 1e-3) == named
    assert not set(names(found)) & {"unequal light", "vibration", "response", "orders"}


@pytest.mark.statistics
def test_clean_scans_are_rarely_given_a_cause():
    """Of 100 scans of noise: seven tests of 0.001 each, of which 0.7 find one by chance."""
    alarms = sum(bool(diagnosed(shots(seed=seed)).named) for seed in range(100))
    # More than 5 in 1 of 10,000 trials.
    assert alarms <= 5
