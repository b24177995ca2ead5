"""Every shipped code on a rendered plane: as near the truth as its theory says, and as noisy."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small
from stages import capture, ground_truth, trace

from slbench.patterns import PatternSequence, decode
from slbench.patterns.registry import pattern_codes

#: Rows of the picture that are looked at.
ROWS = slice(200, 260)
#: Of every family: short text, and what 99 % of the pixels are within without noise, px.  Codes of
#: fringes are as good as the light's floor times their period; whole cells as half a cell; a code
#: of many frequencies is off where the lens, which leaves the low ones, takes the high ones.
CODES = {
    "fringes": ("1,8,64@4", 0.02),
    "gray": ("gray", 0.55),
    "micro": ("micro", 0.025),
    "xor": ("xor4", 3.5),  # its finest stripes are not resolved: cells of four columns
    "orders": ("orders16@4+16@4", 0.05),
    "hamiltonian": ("hamiltonian5", 0.5),  # corners of the curve are rounded
    "two-plus-one": ("gray+two-plus-one16", 0.13),  # one shot of grey: rounding is not averaged
    "two-step": ("white+black+gray+two-step16", 0.07),
    "trapezoid": ("gray+trapezoid16", 0.06),
    "embedded": ("embedded64x3@3", 0.015),
    "fourier": ("gray+fourier64", 1.2),  # its window reaches over the plate's edge
    "speckle": ("speckle10", 0.5),
    "optimised": ("optimised5", 0.15),
    "de-bruijn": ("white+black+de-bruijn8px", 0.05),
}
#: Shown by their own tests: flats have no place, pictures none of their own, three need the whole
#: matrix, one a projector out of focus.
ELSEWHERE = {"flat", "images", "modulated", "composite", "m-array", "binary-fringes"}
#: Of whole cells, or known at edges only: a deviation, but no noise.
CELLS = {"gray", "xor", "de-bruijn"}


@functools.cache
def plane():
    scene = small("plane", divisor=1)
    truth = ground_truth(scene)
    return scene, trace(scene, ("u",)), truth.smooth()[ROWS], truth.panel[ROWS, :, 0]


def coded(text):
    scene = plane()[0]
    return replace(scene, sequence=PatternSequence.parse(text, scene.sequence.panel))


def errors(text, **options):
    _, light, inside, true = plane()
    shots = capture(coded(text), light, **options)
    limits = {"noise": shots.noise, "saturation": shots.top_dn}
    found = decode(shots.frames[:, ROWS], shots.sequence, **limits)
    return (found.coordinate["u"] - true)[inside], found.sigma["u"][inside]


def test_every_family_is_here():
    own = {kind for kind in pattern_codes if pattern_codes.origin(kind) == "slbench"}
    assert set(CODES) | ELSEWHERE == own


@pytest.mark.parametrize("kind", CODES)
def test_without_noise(kind):
    text, limit = CODES[kind]
    error, _ = errors(text, noise=False)
    measured = np.isfinite(error)
    assert measured.mean() > 0.85
    assert np.quantile(np.abs(error[measured]), 0.99) < limit


@pytest.mark.parametrize("kind", sorted(set(CODES) - CELLS))
def test_with_noise(kind):
    """Standard deviation over repeats, over the predicted one."""
    text, _ = CODES[kind]
    drawn = [errors(text, seed=seed) for seed in range(8)]
    values, sigma = (np.array(one) for one in zip(*drawn, strict=True))
    always = np.isfinite(values).all(axis=0)
    # Wrong orders are no noise.
    values, sigma = values[:, always], sigma[:, always]
    single = np.ptp(values, axis=0) < 10.0 * sigma.mean(axis=0)
    ratio = np.var(values[:, single], axis=0, ddof=1) / np.mean(sigma[:, single] ** 2, axis=0)
    # Seven degrees of freedom at some 25,000 pixels: 0.3 %.
    assert always.mean() > 0.8
    assert single.mean() > 0.95
    assert np.sqrt(ratio.mean()) == pytest.approx(1.0, abs=0.05)
