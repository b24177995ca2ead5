"""Which panel axis a rig codes: beside, above, below and rolled; predicted and rendered."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from reference_evaluator import reference

from slbench.core import resources
from slbench.core.errors import InputWarning
from slbench.core.io import read_toml, write_toml
from slbench.design.rig.evaluate import Evaluator, evaluate
from slbench.design.rig.hardware import load_hardware, read_configurations
from slbench.design.rig.optimise import optimise
from slbench.design.rig.verify import plate_errors, rendered_errors, verify
from slbench.patterns.sequence import PatternSequence
from slbench.report.plots.rig_design import scene_of
from slbench.rig import DesignVariables, Pose

MACRO = load_hardware("hardware/macro-ch6")
NATURAL, ROWS, BOTH = (replace(MACRO, coded_axes=axes) for axes in (1, "v", "uv"))
TABLE_4 = read_configurations(resources.find("scenes", "hardware/macro-ch6").parent / "table4.csv")
#: The same field of view on 160 x 120 pixels: a sixteenth of the work.
_COARSE = {"width": 160, "height": 120, "pitch_mm": (0.0296, 0.0296), "principal_point": None}
SMALL = replace(MACRO, camera=replace(MACRO.camera, **_COARSE))
BEND = (0.1, -0.05, 0.001, -0.002, 0.01)
BENT = replace(
    MACRO,
    camera=replace(MACRO.camera, distortion=BEND),
    projector=replace(MACRO.projector, distortion=BEND, tilt_rad=(-0.05, 0.08)),
)


def row(w, h, alpha=0.0, beta=0.0):
    return np.array([756.3, w, h, 337.5, np.deg2rad(alpha), np.deg2rad(beta)])


#: A camera beside the projector, above and below it, and obliquely on both sides.
BESIDE, ABOVE, BELOW = row(-412.5, 0.0), row(0.0, -412.5), row(0.0, 412.5)
#: Several rigs a side, for ranks.
ALL_ABOVE = np.stack((ABOVE, row(-60.0, -300.0, beta=8.0), row(40.0, -180.0, alpha=5.0)))
ALL_BELOW = ALL_ABOVE * (1, 1, -1, 1, 1, -1)


def errors(hardware, rows):
    return Evaluator(hardware).evaluate(hardware.place(rows)).mu_mm


@pytest.mark.parametrize("hardware", [MACRO, BENT], ids=["thin lenses", "distorted"])
def test_rows_are_predicted_as_the_reference_does(hardware):
    rows = np.vstack((ALL_ABOVE, BELOW))
    result = Evaluator(replace(hardware, coded_axes="v")).evaluate(hardware.place(rows))
    assert result.n_points.sum() > 1000
    for k, each in enumerate(rows):
        expected = reference(replace(hardware, coded_axes="v"), DesignVariables(*each))
        got = result.mu_mm[k], result.sigma_mm[k], result.eta[k], result.n_points[k]
        np.testing.assert_allclose(got, expected[:4], rtol=1e-9)


@pytest.mark.parametrize("hardware", [MACRO, BENT], ids=["thin lenses", "distorted"])
def test_rays_along_a_column_have_an_error_like_any(hardware):
    """Columns above the projector: many rays meet theirs where no lens sees it, or never."""
    hardware = replace(hardware, coded_axes="u")
    result = Evaluator(hardware).evaluate(hardware.place(ALL_ABOVE))
    both = replace(hardware, coded_axes="uv")
    every = Evaluator(both).evaluate(both.place(ALL_ABOVE)).n_points
    np.testing.assert_array_equal(result.n_points, every)
    for k, each in enumerate(ALL_ABOVE):
        expected = reference(hardware, DesignVariables(*each))
        # To first order by differences a micrometre apart, of rays along which little changes.
        np.testing.assert_allclose(result.mu_mm[k], expected[0], rtol=1e-4)


def test_a_lens_that_hardly_distorts_has_the_errors_of_one_that_does_not():
    plain = errors(replace(MACRO, coded_axes="u"), ALL_ABOVE)
    for k1, within in ((1e-3, 3e-4), (1e-6, 3e-7)):
        bent = replace(MACRO.projector, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
        hardware = replace(MACRO, projector=bent, coded_axes="u")
        np.testing.assert_allclose(errors(hardware, ALL_ABOVE), plain, rtol=within)


def test_one_axis_is_that_of_the_smaller_error():
    rng = np.random.default_rng(3)
    low, high = (250, -500, -500, 0, -1, -1), (1000, 500, 500, 500, 1, 1)
    rows = np.vstack((ALL_ABOVE, ALL_BELOW, TABLE_4, rng.uniform(low, high, (60, 6))))
    u, v = errors(MACRO, rows), errors(ROWS, rows)
    result = evaluate(NATURAL, rows)
    np.testing.assert_array_equal(result.mu_mm, np.fmin(u, v))
    measured = np.isfinite(result.mu_mm)
    np.testing.assert_array_equal(result.axes[measured], np.where(v < u, "v", "u")[measured])
    assert set(result.axes[:6]) == {"v"}
    assert {"u", "v"} == set(result.axes[24:])


def test_a_stated_axis_is_the_one():
    for hardware, axes in ((MACRO, "u"), (ROWS, "v"), (BOTH, "uv"), (2, "uv")):
        hardware = replace(MACRO, coded_axes=2) if hardware == 2 else hardware
        assert evaluate(hardware, row(-300, -300)).axes.tolist() == [axes]
    two = evaluate(replace(MACRO, coded_axes=2), TABLE_4)
    np.testing.assert_array_equal(two.mu_mm, evaluate(BOTH, TABLE_4).mu_mm)


def test_a_file_without_coded_axes_codes_those_of_its_patterns(tmp_path):
    content = read_toml(resources.find("scenes", "hardware/macro-ch6"))
    del content["design"]["coded_axes"]
    for stated, expected in (("v", "v"), ("vu", "uv"), (None, 1)):
        content["patterns"].pop("axes", None)
        content["patterns"] |= {} if stated is None else {"axes": stated}
        write_toml(tmp_path / "mine.toml", content)
        assert load_hardware(tmp_path / "mine.toml").coded_axes == expected


def test_an_axis_along_the_epipolar_lines_is_questioned():
    with pytest.warns(InputWarning, match=r'1 of 2 rigs .*along the panel\'s columns.*"v"'):
        evaluate(MACRO, np.stack((TABLE_4[4], ABOVE)))
    with pytest.warns(InputWarning, match=r'1 of 1 rigs .*along the panel\'s rows.*"u"'):
        evaluate(ROWS, BESIDE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        evaluate(MACRO, TABLE_4)
        evaluate(ROWS, ALL_ABOVE)
        evaluate(NATURAL, np.vstack((TABLE_4, ALL_ABOVE, ALL_BELOW)))
        evaluate(BOTH, np.vstack((TABLE_4, ALL_ABOVE, ALL_BELOW)))


# -- rendered -----------------------------------------------------------------------------


#: Finest fringes of 160 panel pixels along either axis: what a fringe leaves goes with its period.
FRINGES = {"u": "1,4", "v": "1,3"}
RENDERED = {"samples": 4, "heights_mm": [0.0], "noise": False}
#: Shares by which ratios of rendered errors may be off those of predicted ones, as in
#: ``test_verify``.
WITHIN = 0.13


def densely(hardware, placed):
    """Predict from so many pixels that their choice no longer moves the mean by a per cent."""
    return Evaluator(hardware, stride=(3, 4), planes_mm=[0.0]).evaluate(placed)


def ratio(hardware, row):
    """Rendered error without noise over the predicted one."""
    predicted = densely(hardware, hardware.place(row))
    patterns = FRINGES[predicted.axes[0]]
    return rendered_errors(hardware, row, patterns=patterns, **RENDERED)[0] / predicted.mu_mm[0]


@pytest.fixture(scope="module")
def beside():
    """What a rig of the usual kind renders over what is predicted."""
    return ratio(MACRO, BESIDE)


@pytest.mark.parametrize("row", [ABOVE, BELOW], ids=["above", "below"])
def test_a_camera_above_or_below_renders_what_one_beside_does(row, beside):
    assert ratio(NATURAL, row) == pytest.approx(beside, rel=WITHIN)


@pytest.mark.slow
def test_ranks_of_rigs_above_and_below():
    for rows in (ALL_ABOVE, ALL_BELOW):
        result = verify(NATURAL, rows, samples=1)
        assert result.predicted.axes.tolist() == ["v", "v", "v"]
        assert result.rank_correlation == pytest.approx(1.0)
        assert np.all(result.rendered_mm < 5 * result.predicted.mu_mm)


def test_a_projector_rolled_by_a_quarter_codes_rows(beside):
    """A camera beside a projector on its side."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    placed = MACRO.place(BESIDE)
    placed = replace(placed, projector_rotation=placed.projector_rotation @ turn)
    result = densely(NATURAL, placed)
    assert result.axes.tolist() == ["v"]
    rig = MACRO.rig(BESIDE)
    pose = Pose(rig.projector.pose.rotation @ turn, rig.projector.pose.position)
    rolled = rig.having(projector=replace(rig.projector, pose=pose))
    panel = rolled.projector.width, rolled.projector.height
    sequence = PatternSequence.parse(FRINGES["v"], panel, 3, "v")
    rendered = plate_errors(NATURAL, rolled, sequence, **RENDERED)
    assert rendered[0] / result.mu_mm[0] == pytest.approx(beside, rel=WITHIN)


def test_two_axes_are_predicted_and_rendered_alike():
    rows = np.stack((ABOVE, BESIDE, row(-100.0, -100.0)))
    result = verify(BOTH, rows, samples=1)
    assert set(result.predicted.axes) == {"uv"}
    assert np.all(result.rendered_mm < 5 * result.predicted.mu_mm)
    assert np.argmax(result.rendered_mm) == np.argmax(result.predicted.mu_mm)


def test_patterns_that_state_their_axes_are_what_is_predicted(tmp_path):
    (tmp_path / "rows.toml").write_text('[patterns]\nsequence = "1,5"\naxes = "v"\n')
    with pytest.warns(InputWarning, match="the patterns code v, coded_axes of the hardware is u"):
        result = verify(SMALL, ALL_ABOVE, samples=4, patterns=tmp_path / "rows.toml")
    np.testing.assert_array_equal(
        result.predicted.mu_mm, errors(replace(SMALL, coded_axes="v"), ALL_ABOVE)
    )
    same = verify(replace(SMALL, coded_axes=1), ALL_ABOVE, samples=4)
    np.testing.assert_array_equal(same.rendered_mm, result.rendered_mm)


# -- the search ---------------------------------------------------------------------------


def test_a_search_above_the_projector_codes_rows():
    above = replace(
        NATURAL,
        lower=(600.0, -0.5, -500.0, 100.0, -0.001, -0.3),
        upper=(900.0, 0.5, -200.0, 500.0, 0.001, 0.3),
    )
    design = optimise(above, objectives=["error"], max_evaluations=300)
    best = design.member()
    assert design.evaluation.axes[best] == "v"
    assert design.evaluation.mu_mm[best] < 0.2
    content = {"patterns": {"sequence": "1,5", "axes": "u"}}
    assert scene_of(design, content, best)["patterns"] == {"sequence": "1,5", "axes": "v"}
    with pytest.warns(InputWarning, match="coded_axes u"):
        columns = optimise(
            replace(above, coded_axes="u"), objectives=["error"], max_evaluations=300
        )
    assert columns.evaluation.mu_mm[columns.member()] > 10 * design.evaluation.mu_mm[best]
