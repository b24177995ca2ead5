"""A preview is the same instrument: errors in millimetres and completeness are carried over."""

from dataclasses import replace

import numpy as np
import pytest

from slbench import objects
from slbench.detector.emva1288 import Detector
from slbench.patterns import PatternSequence
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.scene.model import Exposure, Light, Scene, SceneObject
from slbench.simulate.scan import scan


def random_scene(seed, *, absolute, vibration_px=0.0):
    """Return a tilted plate before a random rig, whose pixels are small beside its fringes."""
    rng = np.random.default_rng(seed)
    distance = rng.uniform(200.0, 600.0)
    baseline = distance * rng.uniform(0.3, 0.5)
    left, right = (
        Pose.looking_at((x, 0.0, distance), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0))
        for x in (-0.5 * baseline, 0.5 * baseline)
    )
    field, size = 0.12 * distance, 144
    camera = Camera(
        size, size, (0.006, 0.006), Lens(size * 0.006 * distance / field, 1.0, distance),
        pose=left, blur_px=rng.uniform(0.0, 2.0),
    )  # fmt: skip
    panel = 400
    projector = Projector(
        panel, panel, (0.01, 0.01), Lens(panel * 0.01 * distance / (1.6 * field), 1.0, distance),
        pose=right, blur_px=1.0, flux_w=rng.uniform(0.5, 2.0),
    )  # fmt: skip
    detector = Detector(
        bit_depth=int(rng.choice([8, 10, 12])),
        full_well_e=rng.uniform(3e3, 2e4),
        read_noise_e=rng.uniform(5.0, 20.0),
        dark_current_e_per_s=rng.uniform(0.0, 1e4),
    )
    angle = rng.uniform(-0.3, 0.3)
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    plate = objects.build_artefact("plane", {"size_mm": (3.0 * field, 3.0 * field)})
    scene = Scene(
        f"random-{seed}",
        Rig(camera, projector),
        (SceneObject(plate, Pose(turn, np.zeros(3))),),
        PatternSequence.parse("1,8", (panel, panel)),
        detector=detector,
        exposure=Exposure(vibration_px=vibration_px),
        light=Light(),
        samples=64,
    )
    if absolute:
        # As long as the automatic exposure of the full scene: nearly full wells.
        time = scan(scene, score=False).capture.exposure_s
        scene = replace(scene, exposure=Exposure(time, vibration_px=vibration_px))
    return scene


@pytest.mark.parametrize("absolute", [False, True], ids=["automatic", "absolute"])
@pytest.mark.parametrize("seed", range(5))
def test_preview_and_full_agree(seed, absolute):
    scene = random_scene(seed, absolute=absolute)
    full, preview = scan(scene, seed=1), scan(scene.coarser(3, 64), seed=1)
    assert full.score.completeness > 0.99
    assert preview.score.completeness > 0.99
    # The signal is the same, and so the noise: 2,304 points know a standard deviation to 1.5 %,
    # five of which are 7 %.  Larger pixels take 2 % of the modulation of fringes of 50 px.
    ratio = preview.score.smooth_rms_mm / full.score.smooth_rms_mm
    assert ratio == pytest.approx(1.0, abs=0.1)
    levels = [np.percentile(one.capture.frames, 90) for one in (full, preview)]
    assert levels[1] == pytest.approx(levels[0], rel=0.02, abs=1.5)


@pytest.mark.parametrize("seed", range(3))
def test_vibration_is_carried_over(seed):
    """Its shift is one length on the sensor, so its error is one length on the object."""
    scene = random_scene(seed, absolute=False, vibration_px=1.5)
    quiet = Detector(bit_depth=16, full_well_e=1e9, read_noise_e=0.0, prnu=0.0, dsnu_e=0.0)
    scene = replace(scene, detector=quiet)

    def error(one):
        # All points of one scan share its 12 shifts: many scans tell their deviation.
        repeats = [scan(one, seed=s, score=True).score.smooth_rms_mm for s in range(12)]
        return np.sqrt(np.mean(np.square(repeats)))

    ratio = error(scene.coarser(3, 64)) / error(scene)
    # Twice the same 12 draws of shifts: only what is no shift differs.
    assert ratio == pytest.approx(1.0, abs=0.1)


def test_blur_and_the_corner_stay_where_they_are():
    camera = random_scene(3, absolute=False).rig.camera
    coarse = camera.coarser(5)
    assert coarse.width == 28
    assert coarse.blur_px * coarse.pitch_mm[0] == pytest.approx(camera.blur_px * camera.pitch_mm[0])
    corner = np.array([-0.5, -0.5])
    np.testing.assert_allclose(coarse.unproject(corner)[1], camera.unproject(corner)[1], atol=1e-12)
    assert coarse.etendue_mm2_sr == pytest.approx(camera.etendue_mm2_sr)
    assert coarse.spread.diffraction_px * 5 == pytest.approx(camera.spread.diffraction_px)
