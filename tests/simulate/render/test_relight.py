"""Relit images against Mitsuba's own renders of the same patterns: the package's foundation.

The comparison is statistical.  Both sides are rendered `REPEATS` times with independent seeds;
Welch's t-test is made on every pixel (Bonferroni-corrected) and on the image's mean.  Each
test has a false-alarm rate of `ALPHA`; the 22 of this file together one of 0.22 %.  That the
tests can fail is shown by planted errors: a weight 2 % off, a pattern one panel pixel off.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers_scene import (
    DISTORTION,
    TILT,
    agreement,
    camera,
    projector,
    step_scene,
    with_bounces,
)
from stages import trace

import slbench.simulate.render.trace as tracing
from slbench.core.errors import InputError
from slbench.scene.drawn import Noise
from slbench.scene.environment import environment_of
from slbench.scene.model import Light
from slbench.scene.surfaces.bsdfs import bsdfs
from slbench.scene.surfaces.materials import Material
from slbench.simulate.render.mitsuba import mi
from slbench.simulate.render.translate import mitsuba_dict
from slbench.simulate.transport import LightTransport

ALPHA = 1e-4
REPEATS = 24
SAMPLES = 16

WIDTH, HEIGHT = 160, 120
PHASE = 2.0 * np.pi * (np.arange(WIDTH) + 0.5) / WIDTH
PATTERNS = {
    "1 fringe": np.tile(0.5 + 0.5 * np.cos(PHASE), (HEIGHT, 1)),
    "50 fringes": np.tile(0.5 + 0.5 * np.cos(50.0 * PHASE - 2.0 * np.pi / 3.0), (HEIGHT, 1)),
    "random binary": np.random.default_rng(1).integers(0, 2, (HEIGHT, WIDTH)).astype(float),
}


def glossy(value, bsdf, **more):
    material = Material(bsdfs.get(bsdf)(**{"roughness": 0.4, **more}))
    return replace(value, objects=tuple(replace(o, material=material) for o in value.objects))


#: Surfaces of many parameters, in one bounce.
PRINCIPLED = {
    "painted": {"albedo": 0.5, "clearcoat": 0.8, "clearcoat_gloss": 0.6},
    "half a metal": {"metallic": 0.5, "roughness": 0.5, "specular": 0.8},
    "brushed metal": {"metallic": 1.0, "roughness": 0.5, "anisotropy": 0.8},
    "spotted roughness": {"metallic": 1.0, "roughness": Noise(low=0.4, high=0.8, size_mm=30.0)},
}


@cache
def scene_of(case):
    if case == "pinholes":
        # No vignetting and no aperture: translate takes Mitsuba's stock `projector`.
        return step_scene(camera(), projector(vignetting=False))
    lenses = step_scene(camera(2.0), projector(5.6))
    if case == "lenses":
        return lenses
    if case == "one bounce":
        return with_bounces(lenses, 1)
    if case == "glossy metal":
        return with_bounces(glossy(lenses, "rough_conductor"), 1)
    if case in PRINCIPLED:
        return with_bounces(glossy(lenses, "principled", **PRINCIPLED[case]), 1)
    if case == "ambient light":
        # As bright as the projector's own light (1 W on a field of 200 mm x 150 mm).
        return replace(lenses, light=Light(ambient_w_per_mm2=3e-5, bounces=1))
    if case in ("lamps", "lamps on metal"):
        # Small bright lamps, seen by chance and by aim; uniform light besides.
        around = environment_of("workshop", irradiance_w_per_mm2=3e-5, rotation_deg=20.0)
        light = Light(ambient_w_per_mm2=1e-5, bounces=1, environment=around)
        shown = glossy(lenses, "rough_conductor") if case == "lamps on metal" else lenses
        return replace(shown, light=light)
    if case == "all of the spread":
        # Defocus, diffraction and blur of some 2 px each, in both devices.
        a, b = camera(2.0, focus=500.0, blur_px=1.0), projector(5.6, focus=900.0, blur_px=1.5)
        a, b = (replace(d, lens=replace(d.lens, wavelength_nm=2e4)) for d in (a, b))
        assert min(a.spread.diffraction_px, b.spread.diffraction_px) > 2.0
        return with_bounces(step_scene(a, b), 1)
    assert case == "distorted and tilted"
    errors = {"distortion": DISTORTION, "tilt_rad": TILT}
    return with_bounces(step_scene(camera(2.0, **errors), projector(5.6, **errors)), 1)


@cache
def transports(case):
    return [trace(scene_of(case), ("u", "uv"), samples=SAMPLES, seed=s) for s in range(REPEATS)]


def relit(case, pattern):
    if np.all(pattern == pattern[0]):
        return np.array([t.relight(pattern[:1])[0] for t in transports(case)], np.float64)
    return np.array([t.relight_images(pattern[None])[0] for t in transports(case)], np.float64)


def rendered(case, pattern, integrator):
    scene = scene_of(case)
    content = mitsuba_dict(scene, pattern, SAMPLES)
    if integrator == "direct":
        content["integrator"] = {"type": "direct"}
    else:
        assert content["integrator"]["max_depth"] == 2 + scene.light.bounces
    loaded = mi.load_dict(content)
    images = [mi.render(loaded, spp=SAMPLES, seed=1000 + s).numpy() for s in range(REPEATS)]
    # Mitsuba measures radiance; the lens's fall-off is ours to add.
    camera_ = scene.rig.camera
    return np.array(images, np.float64)[..., 0] * camera_.relative_illumination(
        camera_.pixel_grid()
    )


CASES = [
    ("pinholes", "direct", "projector", "perspective"),
    ("lenses", "direct", "thinlens_projector", "thinlens"),
    ("one bounce", "path", "thinlens_projector", "thinlens"),
    ("distorted and tilted", "path", "thinlens_projector", "slbench_camera"),
    ("all of the spread", "path", "thinlens_projector", "slbench_camera"),
]


@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize(("case", "integrator", "emitter", "sensor"), CASES)
def test_relit_equals_rendered(case, integrator, emitter, sensor, name):
    pattern = PATTERNS[name]
    content = mitsuba_dict(scene_of(case), pattern)
    assert (content["projector"]["type"], content["camera"]["type"]) == (emitter, sensor)
    theirs = rendered(case, pattern, integrator)
    ours = relit(case, pattern)
    # Most of the field is lit, or nothing would be compared.
    assert np.mean(ours.mean(axis=0) > 0.1 * ours.mean()) > 0.6
    result = agreement(theirs, ours)
    assert result.p > ALPHA, (result, ours.mean() / theirs.mean())
    # The same test has the power to see small errors.
    assert agreement(theirs, 1.02 * ours).p < 1e-9
    if case != "all of the spread" or name == "1 fringe":  # which leaves nothing of the others
        shifted = relit(case, np.roll(pattern, 1, axis=1))
        assert agreement(theirs, shifted).p < 1e-9


@pytest.mark.parametrize(
    "case", ["glossy metal", "ambient light", "lamps", "lamps on metal", *PRINCIPLED]
)
def test_other_light_and_material(case):
    pattern = PATTERNS["1 fringe"]
    theirs, ours = rendered(case, pattern, "path"), relit(case, pattern)
    result = agreement(theirs, ours)
    assert result.p > ALPHA, result
    assert agreement(theirs, 1.02 * ours).p < 1e-9


def test_a_forgotten_bounce_is_seen():
    """The bounce adds only 0.2 % to the image's mean: the test for it has power all the same."""
    pattern = PATTERNS["1 fringe"]
    with_it, without = relit("one bounce", pattern), relit("lenses", pattern)
    assert 1.001 < with_it.mean() / without.mean() < 1.01
    assert agreement(rendered("one bounce", pattern, "path"), without).p < 1e-9


def test_the_two_product_ways_agree():
    """Fringes through the u marginal equal fringes through the full matrix."""
    for case, tolerance in (("pinholes", 3e-5), ("all of the spread", 0.01)):
        t = transports(case)[0]
        for name in ("1 fringe", "50 fringes"):
            full = t.relight_images(PATTERNS[name][None])
            ours = t.relight(PATTERNS[name][:1])
            # Without any spread: weights rounded to 15 bits, 1.5e-5, on either side.  With it the
            # full matrix has 32 points a footprint instead of its integral.
            white = t.white().max()
            np.testing.assert_allclose(ours, full, rtol=0.0, atol=tolerance * white)


@pytest.fixture(scope="module")
def all_marginals():
    return trace(scene_of("one bounce"), ("u", "v", "uv"), samples=SAMPLES, seed=3)


class TestTrace:
    """What holds for any trace."""

    def test_marginals_are_sums_of_the_full_matrix(self):
        pinholes = trace(scene_of("pinholes"), ("u", "v", "uv"), samples=SAMPLES, seed=3)
        full = pinholes.marginals["uv"].tocsr().astype(np.float64).toarray()
        full = full.reshape(-1, HEIGHT, WIDTH)
        for name, axis in (("u", 1), ("v", 2)):
            rows = pinholes.marginals[name].tocsr().toarray()
            # Weights rounded to 15 bits, 1.5e-5, on either side.
            np.testing.assert_allclose(rows, full.sum(axis=axis), rtol=3.2e-5, atol=1e-12)
            assert np.count_nonzero(rows) > 80 * 60

    def test_the_panel_ends_in_both_directions(self, all_marginals):
        """All marginals hold the same light, that of footprints which the panel cuts included."""
        whites = [
            LightTransport({name: rows}, all_marginals.ambient, (WIDTH, HEIGHT), SAMPLES).white()
            for name, rows in all_marginals.marginals.items()
        ]
        brightest = whites[2].max()
        for white in whites[:2]:
            # The full matrix cuts 32 points a footprint, which rounds shares at the very edge.
            np.testing.assert_allclose(white, whites[2], rtol=0.0, atol=0.02 * brightest)
            assert white.mean() == pytest.approx(whites[2].mean(), rel=1e-3)

    def test_dual_photography_is_the_adjoint(self, all_marginals):
        rng = np.random.default_rng(5)
        panel = rng.random((HEIGHT, WIDTH))
        image = rng.random(all_marginals.shape)
        ahead = np.sum(all_marginals.relight_images(panel[None])[0].astype(np.float64) * image)
        back = np.sum(all_marginals.view_from_projector(image) * panel)
        # float32 products of 4800 pixels; rounding errors add at random.
        assert ahead == pytest.approx(back, rel=1e-6)

    def test_same_seed_same_bytes_and_another_seed_others(self):
        first, again, other = (
            trace(scene_of("lenses"), ("u",), samples=SAMPLES, seed=s) for s in (7, 7, 8)
        )
        a, b, c = (t.marginals["u"] for t in (first, again, other))
        for name in ("indptr", "indices", "data"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
        assert first.ambient.tobytes() == again.ambient.tobytes()
        assert a.data.tobytes() != c.data.tobytes()

    def test_pass_size_changes_nothing_but_the_noise(self, monkeypatch):
        pattern = PATTERNS["50 fringes"][:1]
        whole = np.array([t.relight(pattern)[0] for t in transports("one bounce")], np.float64)
        # 2^14 lanes, 32 a pixel (16 samples, 2 depths), are 512 pixels a pass: 9.4 passes, so
        # that the last one is short.
        monkeypatch.setattr(tracing, "_LANES_PER_PASS", 1 << 14)
        parts, progress = [], []
        for seed in range(8):
            t = trace(
                scene_of("one bounce"),
                ("u",),
                samples=SAMPLES,
                seed=500 + seed,
                on_progress=progress.append,
            )
            assert t.marginals["u"].indptr.size == 80 * 60 + 1
            parts.append(t.relight(pattern)[0])
        assert len(progress) == 8 * 10
        assert progress[9] == 1.0
        assert np.all(np.diff(progress[:10]) > 0)
        in_parts = np.array(parts, np.float64)
        assert agreement(whole, in_parts).p > ALPHA
        assert agreement(whole, 1.02 * in_parts).p < 1e-9

    def test_defaults_come_from_the_scene(self):
        scene = scene_of("lenses")
        coded_v = scene.with_patterns("1", axes="v")
        t = trace(coded_v)
        assert set(t.marginals) == {"v"}
        assert t.marginals["v"].tocsr().shape == (80 * 60, HEIGHT)
        assert (t.samples, t.shape, t.panel) == (16, (60, 80), (WIDTH, HEIGHT))
        assert not t.ambient.any()

    def test_samples_are_rounded_up_to_strata(self):
        t = trace(scene_of("lenses"), samples=7, seed=0)
        assert t.samples == 8
        # The mean does not depend on the number of samples: no sample is lost or counted twice.
        white = [trace(scene_of("lenses"), samples=7, seed=s).white().mean() for s in range(12)]
        reference = [t.white().mean() for t in transports("lenses")]
        error = np.hypot(np.std(white) / np.sqrt(12), np.std(reference) / np.sqrt(REPEATS))
        # 5 standard errors: a false-alarm rate below 1e-4 with 11 degrees of freedom too.
        assert abs(np.mean(white) - np.mean(reference)) < 5.0 * error
        assert error < 1e-3 * np.mean(reference)

    def test_an_unknown_marginal_is_an_input_error(self):
        with pytest.raises(InputError, match=r"marginals\[0\]: expected u, v or uv, got 'w'"):
            trace(scene_of("lenses"), ("w",))  # type: ignore[arg-type]
