"""The two-term law, vibration, and sources of error alone, against closed forms."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes_small import small, transport_of, truth_of
from stages import ground_truth, trace

from slbench.bench.budget.sources import ideal
from slbench.bench.compare.compare import compare
from slbench.cloud.triangulation import intersect_axis
from slbench.core.errors import InputError
from slbench.design.fringes.trial import noise_of_scene
from slbench.thesis.ch7 import budget as module
from slbench.thesis.ch7.budget import object_truth, variations
from slbench.thesis.ch7.report import thesis_law
from slbench.thesis.ch7.twoterm import (
    TwoTerm,
    constant_for_ratio,
    exponent,
    noisy_detector,
    sensitivity_mm,
    vibration_std_mm,
)
from slbench.thesis.published import SETS, STD_UM

NAME = "ch7-step-block"
positive = st.floats(0.1, 1e3)


@functools.cache
def block_truth():
    return object_truth(truth_of(NAME))


class TestTwoTermLaw:
    @given(c=positive, s_0=st.floats(0.0, 1e2))
    def test_two_points_give_it_back(self, c, s_0):
        law = TwoTerm(c, s_0)
        found = TwoTerm.through((4, law.sigma(4)), (50, law.sigma(50)))
        # Differences of squares lose digits where s_0 is much larger than c / n.
        assert found.sigma(16) == pytest.approx(law.sigma(16), rel=1e-5)

    def test_the_thesis_follows_it(self):
        # From 4 and 50 fringes, what 16 would have; within 5 % of tables 8 and 9 for three
        # objects and 14.1 % too much for the propeller, where 1/n misses by a quarter and more.
        ratio = {name: thesis_law(sigma).sigma(16) / sigma[2] for name, sigma in STD_UM.items()}
        assert ratio.pop("ch7-propeller") == pytest.approx(1.141, abs=1e-3)
        assert list(ratio.values()) == pytest.approx([1.010, 1.001, 1.043], abs=1e-3)
        for sigma in STD_UM.values():
            assert sigma[1] * 4 / 16 < 0.77 * sigma[2]
        law = thesis_law(STD_UM[NAME])
        assert law.c == pytest.approx(761.8, abs=0.1)
        assert law.s_0 == pytest.approx(44.31, abs=0.01)

    @pytest.mark.parametrize(
        ("few", "many"),
        [((4, 1.0), (50, 2.0)), ((4, 13.0), (50, 1.0)), ((50, 1.0), (4, 2.0)), ((4, 1.0), (50, 0))],
    )
    def test_other_points_are_refused(self, few, many):
        with pytest.raises(InputError, match="no faster than 1/n"):
            TwoTerm.through(few, many)

    def test_powers(self):
        assert exponent((50, 4, 16), (1 / 50, 1 / 4, 1 / 16)) == pytest.approx(-1.0)
        assert exponent((50, 4, 16), (0.3, 0.3, 0.3)) == pytest.approx(0.0, abs=1e-12)
        assert math.isnan(exponent((50, 4, 16), (0.0, 0.3, 0.3)))

    def test_the_constant_that_makes_a_ratio(self):
        s = constant_for_ratio(70.0, 7.5, 4.17)
        assert math.hypot(70.0, s) / math.hypot(7.5, s) == pytest.approx(4.17)
        with pytest.raises(InputError, match="ratio"):
            constant_for_ratio(70.0, 7.5, 12.0)


class TestSensitivity:
    def test_is_the_slope_of_the_point(self):
        scene, truth = small(NAME), block_truth()
        v, u = np.nonzero(truth.smooth())
        origins, directions = scene.rig.camera.unproject(np.column_stack((u, v)))
        ends = [
            intersect_axis(scene.rig.projector, origins, directions, truth.panel[v, u, 0] + d, "u")[
                0
            ]
            for d in (-0.01, 0.01)
        ]
        slope = (ends[1] - ends[0]) / 0.02
        # A central difference over 0.02 px: its error is of the order 1e-8 of the slope.
        np.testing.assert_allclose(
            sensitivity_mm(scene, truth), np.linalg.norm(slope, axis=1), rtol=1e-6
        )
        np.testing.assert_allclose(
            sensitivity_mm(scene, truth, height=True), np.abs(slope[:, 2]), rtol=1e-6
        )


class TestSourcesAlone:
    def test_without_any_repeats_agree(self):
        scene = ideal(small(NAME))
        found = compare(
            scene, SETS, repeats=2, transports=(transport_of(NAME),), truth=block_truth()
        )
        # Relative noise of 1e12 electrons is 1e-6, a fifteenth of a 16 bit grey level, which one
        # pixel in ten reads differently: at most 0.2 um of {1,2,4}, whose deviation is 74 um.
        assert all(np.nanmedian(result.std_mm) == 0.0 for result in found.sets)
        assert all(result.std_median_mm < 1e-4 for result in found.sets)

    def test_shot_noise_goes_as_one_over_n(self):
        scene = small(NAME)
        listed = variations(scene, transport_of(NAME), vibration_px=0.1, repeats=12)
        shot = next(v for v in listed if v.name == "shot noise")
        found = compare(
            shot.scene,
            ("1,2,4", "1,2,4,8,16"),
            repeats=12,
            transports=(transport_of(NAME),),
            truth=block_truth(),
        )
        four, sixteen = found.sets
        # The footprint takes 2 % of the modulation of 16 fringes.  With three shifts, noise also
        # depends on the phase, its variance by up to half, and the block's faces do not meet
        # all phases alike: some per cent of the medians.  Movement would give 1, not 4.
        assert four.std_median_mm / sixteen.std_median_mm == pytest.approx(4.0, rel=0.12)

    def test_vibration_does_not_depend_on_n(self):
        scene, vibration, repeats = ideal(small("plane", divisor=8)), 0.03, 120
        moving = replace(scene, exposure=replace(scene.exposure, vibration_px=vibration))
        truth = object_truth(ground_truth(scene))
        found = compare(
            moving, ("1,4", "1,8"), repeats=repeats, transports=(trace(scene, ("u",)),), truth=truth
        )
        predicted = vibration * np.median(vibration_std_mm(scene, truth))
        # All pixels of a frame move together: a deviation from 120 repeats is known to
        # 1 / sqrt(2 * 119) = 6.5 %; 26 % are four of these, one false alarm in 16,000 each.
        # What goes as 1/n would make the two differ by a factor 2.
        for result in found.sets:
            assert result.std_median_mm == pytest.approx(predicted, rel=0.26)

    def test_every_source_has_one_row_and_the_floor_is_first(self):
        listed = variations(small(NAME), transport_of(NAME), vibration_px=0.1, repeats=5)
        names = [v.name for v in listed]
        assert len(set(names)) == len(names)
        assert names[0].startswith("floor")
        assert {v.kind for v in listed} == {"steady", "random"}
        floor = listed[0].scene
        assert floor.rig.camera.lens.aperture_radius_mm == 0.0
        assert floor.rig.projector.bit_depth is None

    def test_a_budget_on_few_pixels(self, monkeypatch):
        chosen = ("floor", "projector gamma 1.1", "fixed pattern", "quantisation")
        original = module.variations

        def few(*arguments, **options):
            return [v for v in original(*arguments, **options) if v.name.startswith(chosen)]

        monkeypatch.setattr(module, "variations", few)
        scene = small(NAME)
        # The light of pinholes is traced; that of the scene serves the sources with apertures.
        found = module.error_budget(
            scene, transport_of(NAME), block_truth(), vibration_px=0.1, repeats=2
        )
        floor, gamma, quantised, fixed = found.rows
        # PRNU and DSNU scale and shift all frames of a pixel alike: the phase does not see them.
        assert max(fixed.steady_mm) < 1e-3
        # The second harmonic of a bent response moves the phase alike for all n: as 1/n, so
        # that four fringes are off by more than ten times as much as fifty.
        assert gamma.steady_mm[1] > 10 * gamma.steady_mm[0]
        assert gamma.heights_mm[1] > 0.05 > gamma.heights_mm[0]
        assert quantised.steady_mm[1] > 3 * quantised.steady_mm[0]
        assert found["quantisation, 8 bit"] is quantised
        # Square panel pixels and footprints: at most a tenth of a panel pixel, 0.05 mm.
        assert max(floor.steady_mm) < 0.05


def test_the_stage_is_no_part_of_the_object():
    truth = truth_of(NAME)
    alone = object_truth(truth)
    assert np.all(alone.object_id[alone.lit] == 0)
    assert np.array_equal(alone.lit, truth.lit & (truth.object_id == 0))
    assert np.count_nonzero(truth.lit & (truth.object_id == 1)) > 100


def test_a_detector_with_the_thesis_noise():
    scene = small(NAME)
    dim = replace(scene, detector=noisy_detector(scene, 0.036, 0))
    measured = noise_of_scene(dim, [1], z_mm=[0.0], repeats=12, seed=5).sigma_rad[0, 0]
    # The plate's root mean square lies a few per cent above its median, as pixels differ.
    assert measured == pytest.approx(0.036, rel=0.06)
    with pytest.raises(InputError, match="phase noise"):
        noisy_detector(scene, 1e-9, 0)
