"""Ball bars have balls of certified size and spacing."""

import math

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st
from macro_artefacts import (
    BALL_BAR,
    check_refused,
    check_repeatable,
    check_shipped,
    check_solid,
    fresh,
)

from slbench import objects


@settings(max_examples=20)
@given(
    scale=st.floats(0.1, 10.0),
    spacing=st.floats(15.0, 100.0),
    stem=st.floats(0.5, 7.0),
    length=st.floats(1.3, 10.0),
)
def test_any_ball_bar_is_one_solid_of_its_volume(scale, spacing, stem, length):
    lengths = {key: value * scale for key, value in BALL_BAR.items() if key.endswith("_mm")}
    bar = fresh(
        "ball_bar",
        {
            **lengths,
            "spacing_mm": spacing * scale,
            "stem_diameter_mm": stem * scale,
            "stem_length_mm": length * scale,
            "max_form_error_um": 20.0 * scale,
        },
    )
    check_solid(bar.mesh)
    measured = objects.measure(bar)
    assert set(bar.certified) <= set(measured)
    assert measured["ball_spacing_mm"] == pytest.approx(spacing * scale, rel=1e-12)
    # The cap that the stem takes leaves the mean of the rest off by a share of the sag,
    # 20 um of 5 mm, as its facets are not the average ones.
    for ball in ("ball_1", "ball_2"):
        assert measured[f"{ball}_diameter_mm"] == pytest.approx(10.0 * scale, rel=2e-4)
    assert measured["reference_flatness_um"] < 1e-9
    a, r = stem / 2, 5.0
    outside = math.pi * a**2 * (r + length) - 2 / 3 * math.pi * (r**3 - (r**2 - a**2) ** 1.5)
    volume = 2 * (4 / 3 * math.pi * r**3 + outside) + (spacing + 2 * r) * 8.0 * 4.0
    # Balls of exactly their volume; the stems end on facets instead of the sphere, 20 um off.
    tolerance = 2 * math.pi * a**2 * 0.02
    assert bar.mesh.volume == pytest.approx(volume * scale**3, abs=tolerance * scale**3)


def test_least_squares_spheres_through_the_upper_halves():
    bar = objects.load_artefact("ball-bar")
    mesh = bar.mesh
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    rng = np.random.default_rng(4)
    fitted = []
    for ball in bar.spheres:
        # As a scanner sees it: points on the facets of the upper half.
        upper = (np.linalg.norm((a + b + c) / 3 - ball.centre_mm, axis=1) < 5.1) & (a[:, 2] > 0)
        chosen = rng.choice(np.flatnonzero(upper), 5000)
        weights = rng.dirichlet([1, 1, 1], 5000)
        corners = np.stack([a[chosen], b[chosen], c[chosen]], axis=1)
        points = np.einsum("kc,kcd->kd", weights, corners)
        start = [*(np.array(ball.centre_mm) + 0.1), 4.9]
        fit = scipy.optimize.least_squares(
            lambda p, points=points: np.linalg.norm(points - p[:3], axis=1) - p[3], start
        )
        # The facets' sag, 0.2 um at most, averages over 5000 points to a few nanometres;
        # ten times that, for the centre's height is weaker on half a sphere.
        np.testing.assert_allclose(fit.x, [*ball.centre_mm, 5.0], atol=5e-5)
        fitted.append(fit.x[:3])
    assert np.linalg.norm(fitted[1] - fitted[0]) == pytest.approx(40.0, abs=5e-5)


def test_measure_finds_a_ball_that_moved():
    bar = fresh("ball_bar", BALL_BAR)
    vertices = bar.mesh.vertices.copy()
    vertices[(vertices[:, 0] > 10.0) & (vertices[:, 2] > -5.5), 0] += 1e-3
    moved = objects.Artefact(
        "m", "ball_bar", {}, objects.Mesh(vertices, bar.mesh.faces), {}, bar.features
    )
    # Some micrometres beyond its place, far from what rounding does.
    assert objects.measure(moved)["ball_spacing_mm"] == pytest.approx(40.001, abs=1e-9)


def test_parts_and_reference():
    bar = fresh("ball_bar", BALL_BAR)
    assert list(bar.parts) == ["balls", "bar"]
    balls = bar.mesh.vertices[bar.mesh.faces[bar.parts["balls"]]]
    centres = np.where(balls[..., :1] > 0, 1, -1) * [20.0, 0.0, 0.0]
    distance = np.linalg.norm(balls - centres, axis=-1)
    # The sphere's own vertices, and those of the rims on its facets: the form error.
    assert np.abs(distance - 5.0).max() < 0.02
    # Stems and bar are below.
    other = bar.mesh.vertices[bar.mesh.faces[bar.parts["bar"]]]
    assert other[..., 2].max() < -4.0
    face = bar.reference
    assert face.x_mm == pytest.approx((-20 + 5 + 0.8, 20 - 5 - 0.8))
    assert face.z_mm == -8.0
    places = np.random.default_rng(5).uniform(*np.transpose([face.x_mm, face.y_mm]), (200, 2))
    assert objects.surface_height(bar.mesh, places) == pytest.approx(-8.0, abs=1e-12)


def test_the_shipped_ball_bar():
    bar = check_shipped("ball-bar")
    check_solid(bar.mesh)
    check_repeatable("ball_bar", BALL_BAR)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"spacing_mm": 10.0}, "spacing_mm"),
        ({"ball_diameter_mm": 30.0}, "spacing_mm"),
        ({"stem_diameter_mm": 7.1}, "stem_diameter_mm"),
        ({"bar_width_mm": 3.0}, "stem_diameter_mm"),
        ({"stem_length_mm": 1.0}, "stem_length_mm"),
        ({"spacing_mm": 15.0, "margin_fraction": 0.4}, "margin_fraction"),
        ({"ball_diameter_mm": 1000.0, "spacing_mm": 5e3}, "stem_length_mm"),
    ],
)
def test_refused_ball_bars(change, key):
    check_refused("ball_bar", BALL_BAR, change, key)
