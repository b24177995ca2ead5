"""The evaluator against its slow reference, closed forms, and thesis tables 4 and 5."""

from dataclasses import replace

import numpy as np
import pytest
from reference_evaluator import reference
from scipy.stats import spearmanr

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import plain
from slbench.design.rig.evaluate import evaluate
from slbench.design.rig.hardware import load_hardware, read_configurations
from slbench.rig import DesignVariables, Lens

MACRO = load_hardware("hardware/macro-ch6")
TABLE_4 = read_configurations(resources.find("scenes", "hardware/macro-ch6").parent / "table4.csv")
#: Thesis table 5: mu, sigma (mm), eta, N_s, d (mm).
TABLE_5 = np.array(
    [
        [0.3295, 0.0647, 0.158, 443, 5.52],
        [0.3366, 0.0669, 0.162, 388, 5.57],
        [0.3430, 0.0660, 0.155, 295, 6.68],
        [0.3432, 0.0677, 0.158, 314, 6.63],
        [0.3519, 0.0781, 0.158, 826, 4.23],
        [0.3612, 0.0774, 0.156, 646, 4.82],
        [0.3640, 0.0673, 0.158, 509, 5.25],
        [0.3860, 0.0718, 0.163, 129, 8.43],
        [0.3870, 0.0707, 0.166, 139, 8.18],
        [0.4319, 0.0829, 0.156, 584, 5.07],
        [0.4422, 0.0795, 0.166, 314, 6.60],
        [0.5107, 0.1072, 0.166, 908, 4.08],
        [0.5515, 0.1205, 0.164, 527, 5.25],
        [0.5634, 0.1605, 0.098, 30, 9.71],
        [0.6553, 0.1647, 0.158, 321, 6.77],
        [0.7253, 0.1673, 0.162, 995, 3.96],
        [1.4571, 0.3878, 0.165, 1037, 3.87],
        [1.5306, 0.4023, 0.158, 238, 7.46],
    ]
)
#: The randomly generated, feasible configuration of thesis 6.2.
FEASIBLE = np.array([810.99, -413.97, -162.56, 159.65, *np.deg2rad([-25.58, 10.89])])


def columns(result):
    return np.stack(
        (
            result.mu_mm,
            result.sigma_mm,
            result.eta,
            result.n_points.astype(float),
            result.dispersion_mm,
        ),
        axis=1,
    )


# -- the thesis's tables ------------------------------------------------------------------


def test_table_5_from_table_4():
    ours = columns(evaluate(MACRO, TABLE_4))
    off = np.mean(np.abs(ours / TABLE_5 - 1), axis=0)
    # Stated in rig-design: eta to 4 %, N_s to 4 %, d to 5 %, with room for the phase of the
    # sampling lattice, which the thesis does not state.
    assert off[2] < 0.06
    assert off[3] < 0.06
    assert off[4] < 0.08
    assert spearmanr(ours[:, 0], TABLE_5[:, 0])[0] >= 0.85
    # Errors with pixel centres are about a third of table 5's.
    assert np.median(ours[:, 0] / TABLE_5[:, 0]) == pytest.approx(1 / 3, abs=0.05)


def test_configuration_5_against_the_feasible_one():
    result = evaluate(MACRO, np.stack((TABLE_4[4], FEASIBLE)))
    # About 0.68 here; the thesis measured 0.71.  Starting the sampling lattice at other
    # columns and rows moves this ratio between 0.62 and 0.76.
    assert result.mu_mm[0] / result.mu_mm[1] == pytest.approx(0.68, abs=0.06)


def test_table_5_s_errors_by_the_convention_that_it_must_have_had():
    ours = columns(evaluate(MACRO, TABLE_4, convention="thesis"))
    ratio = ours[:, 0] / TABLE_5[:, 0]
    assert np.median(ratio) == pytest.approx(0.88, abs=0.01)
    assert np.std(ratio) / np.mean(ratio) < 0.03  # 0.14 with pixel centres
    assert spearmanr(ours[:, 0], TABLE_5[:, 0])[0] > 0.99
    assert spearmanr(ours[:, 1], TABLE_5[:, 1])[0] > 0.94
    # Correspondences are the same: only where a point is reconstructed differs.
    np.testing.assert_array_equal(ours[:, 2:], columns(evaluate(MACRO, TABLE_4))[:, 2:])
    # The thesis measured 0.712.
    pair = evaluate(MACRO, np.stack((TABLE_4[4], FEASIBLE)), convention="thesis")
    assert pair.mu_mm[0] / pair.mu_mm[1] == pytest.approx(0.717, abs=0.002)


@pytest.mark.parametrize(
    ("hardware", "convention", "message"),
    [
        (replace(MACRO, coded_axes=2), "thesis", "one coded axis"),
        (
            replace(MACRO, camera=replace(MACRO.camera, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))),
            "thesis",
            "without distortion",
        ),
        (MACRO, "edges", "centres or thesis"),
    ],
)
def test_conventions_are_refused_in_one_line(hardware, convention, message):
    with pytest.raises(InputError, match=f"^convention.*{message}"):
        evaluate(hardware, TABLE_4, convention=convention)


# -- against the reference ----------------------------------------------------------------

RATIONAL = (-0.05, 0.08, 0.001, -0.002, 0.01, 0.1, -0.14, 0.05, 0.001, -0.002, -0.001, 0.003)
BENT = replace(
    MACRO,
    camera=replace(MACRO.camera, distortion=(0.1, -0.05, 0.001, -0.002, 0.01)),
    projector=replace(MACRO.projector, distortion=(-0.08, 0.1, 0.002, 0.001, 0.0)),
)
TILTED = replace(
    MACRO,
    camera=replace(MACRO.camera, tilt_rad=(0.1, -0.05)),
    projector=replace(MACRO.projector, tilt_rad=(-0.05, 0.08)),
)
VARIANTS = {
    "thin lenses": MACRO,
    "distorted": BENT,
    "rational": replace(
        MACRO,
        camera=replace(MACRO.camera, distortion=RATIONAL[:8]),
        projector=replace(MACRO.projector, distortion=RATIONAL, tilt_rad=(-0.05, 0.08)),
    ),
    "lens shift": replace(BENT, projector=replace(BENT.projector, principal_point=(300.0, 491.0))),
    "distorted camera": replace(BENT, projector=MACRO.projector),
    "tilted": TILTED,
    "tilted and distorted": replace(TILTED, camera=replace(BENT.camera, tilt_rad=(0.1, -0.05))),
    "telecentric camera": replace(
        MACRO, camera=replace(MACRO.camera, lens=Lens.telecentric(0.06, 0.004, 500.0))
    ),
    "telecentric projector": replace(
        MACRO, projector=replace(MACRO.projector, lens=Lens.telecentric(0.06, 0.004, 700.0))
    ),
    "distorted camera, telecentric projector": replace(
        BENT, projector=replace(MACRO.projector, lens=Lens.telecentric(0.06, 0.004, 700.0))
    ),
}


def check(hardware, rows, **options):
    result = evaluate(hardware, rows, **options)
    expected = [reference(hardware, DesignVariables(*row), **options) for row in rows]
    # The same mathematics in another order: rounding only.
    np.testing.assert_allclose(columns(result), expected, rtol=1e-9, atol=1e-9)
    return result


@pytest.mark.filterwarnings("ignore:coded_axes v")  # of rigs with a baseline along u
@pytest.mark.parametrize("axes", ["u", "v", "uv"])
@pytest.mark.parametrize("name", VARIANTS)
def test_agrees_with_the_reference(name, axes):
    result = check(replace(VARIANTS[name], coded_axes=axes), TABLE_4[::4])
    assert result.n_points.sum() > 1000  # there was something to agree on


def test_agrees_with_the_reference_over_the_design_space():
    rng = np.random.default_rng(11)
    rows = MACRO.lower + rng.random((40, 6)) * (np.array(MACRO.upper) - MACRO.lower)
    # Where the camera has come behind the plane, the reference has no rays to follow.
    rows = rows[rows[:, 0] > rows[:, 3] + 50]
    check(MACRO, rows)


@pytest.mark.parametrize("stride", [(3, 2), (7, 1), (300, 200), (2000, 2000)])
@pytest.mark.parametrize("distorted", [False, True])
def test_agrees_with_the_reference_at_any_stride(stride, distorted):
    check(BENT if distorted else MACRO, TABLE_4[[4]], stride=stride, planes_mm=[-14.2, 0.3])


def test_agrees_with_the_reference_where_the_threads_share_rows():
    # So many pixels that a configuration, not the batch, is what the threads share.
    check(MACRO, TABLE_4[[4]], stride=(2, 2))


def test_neighbours_are_found_between_planes():
    # Sparse pixels and close planes: the nearest point is often on another plane.
    result = check(MACRO, TABLE_4[:6], stride=(60, 60), planes_mm=np.arange(-15, 15.1, 1.5))
    assert np.all(result.dispersion_mm < 5)  # pixels alone would be over 10 mm apart


@pytest.mark.parametrize("axes", ["u", 2])
def test_rays_on_edges_are_not_left_to_rounding(axes):
    # A plane of symmetry, and a row of camera pixels in it: all of it meets the middle line of a
    # panel with an even number of lines.  The corners of the volume lie on rays.
    camera = replace(MACRO.camera, principal_point=(320.0, 240.0))
    hardware = replace(MACRO, camera=camera, coded_axes=axes)
    rows = [[z, w, 0, z / 2, a, 0] for z in (400, 600) for w in (-200, -400) for a in (0.0, -0.2)]
    straight = check(hardware, np.array(rows))
    # Distortion that moves nothing leads through other code.
    bent = replace(hardware, camera=replace(camera, distortion=(1e-13, 0.0, 0.0, 0.0, 0.0)))
    np.testing.assert_array_equal(straight.n_points, evaluate(bent, rows).n_points)
    assert straight.n_points.sum() > 5000


# -- closed forms -------------------------------------------------------------------------


def test_error_of_one_pixel_in_closed_form():
    # Camera beside the projector, both facing the origin; one pixel, on the camera's axis,
    # so that T is the origin, and a panel shifted by a fraction of a column.
    shift = 0.3
    camera = replace(MACRO.camera, width=1, height=1, principal_point=None)
    projector = replace(MACRO.projector, principal_point=(320.0 + shift, 240.0))
    hardware = replace(MACRO, camera=camera, projector=projector)
    row = [700.0, -400.0, 0.0, 100.0, 0.0, 0.0]
    result = evaluate(hardware, row, stride=(1, 1), planes_mm=[0.0])
    # In the plane y = 0: the column's plane is x = -shift * pitch / f * depth, at the origin
    # as seen from the projector; the camera's ray is d = (400, 600) / |.| from (-400, 100).
    slope = -shift * projector.pitch_mm[0] / projector.lens.focal_length_mm
    d = np.array([400.0, 600.0]) / np.hypot(400, 600)
    # x = t d0, depth = 700 + t d1: solve t d0 = slope (700 + t d1).
    t = slope * 700.0 / (d[0] - slope * d[1])
    assert result.mu_mm[0] == pytest.approx(abs(t), rel=1e-9)
    assert result.n_points[0] == 1
    assert np.isnan(result.sigma_mm[0])
    assert np.isnan(result.dispersion_mm[0])
    assert np.all(np.isinf(result.objectives[0]))


def test_the_coded_axes_change_the_error_and_not_the_vote():
    one = evaluate(MACRO, TABLE_4)
    two = evaluate(replace(MACRO, coded_axes=2), TABLE_4)
    np.testing.assert_array_equal(one.n_points, two.n_points)
    np.testing.assert_array_equal(one.dispersion_mm, two.dispersion_mm)
    assert np.all(one.mu_mm != two.mu_mm)


# -- the result ---------------------------------------------------------------------------


def test_distances_angle_margins_and_rows():
    result = evaluate(MACRO, TABLE_4)
    assert len(result) == 18
    assert result.feasible.all()
    for i, row in enumerate(TABLE_4):
        rig = MACRO.rig(row)
        assert result.camera_distance_mm[i] == pytest.approx(rig.camera_distance)
        assert result.projector_distance_mm[i] == pytest.approx(rig.projector_distance)
        assert result.angle_deg[i] == pytest.approx(np.rad2deg(rig.angle))
    rows = plain(result.rows())
    assert list(rows[0]) == [
        "mu_mm",
        "sigma_mm",
        "eta",
        "n_points",
        "dispersion_mm",
        "feasible",
        "margins",
        "camera_distance_mm",
        "projector_distance_mm",
        "angle_deg",
        "axes",
    ]
    assert list(rows[0]["margins"]) == ["g1", "g2", "g3", "g4", "g5", "g6"]
    np.testing.assert_allclose(
        result.objectives[4],
        [
            result.mu_mm[4] * result.sigma_mm[4],
            -result.eta[4] * result.n_points[4],
            -result.dispersion_mm[4],
        ],
    )


def test_a_batch_is_the_sum_of_its_parts():
    together = columns(evaluate(MACRO, TABLE_4))
    alone = np.concatenate([columns(evaluate(MACRO, row)) for row in TABLE_4])
    np.testing.assert_array_equal(together, alone)


def test_what_is_no_rig_has_no_points_and_no_margin():
    rows = np.stack((TABLE_4[0], [500.0, 0, 0, 100, -np.pi / 2, 0.2], TABLE_4[1]))
    result = evaluate(MACRO, rows)
    np.testing.assert_array_equal(result.n_points > 0, [True, False, True])
    assert np.isnan(result.mu_mm[1])
    assert not result.feasible[1]
    # A camera behind the reference plane sees nothing of it from the front.
    behind = evaluate(MACRO, [300.0, -100, -100, 450, 0.0, 0.2])
    assert behind.n_points[0] == 0
    assert behind.margins[0, 0] < 0


def test_an_empty_batch_is_empty():
    assert len(evaluate(MACRO, np.empty((0, 6)))) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stride": (0, 1)}, "stride"),
        ({"stride": (1.5, 2)}, "stride"),
        ({"stride": (1, 2, 3)}, "stride"),
        ({"planes_mm": [20.0]}, "planes"),
        ({"planes_mm": []}, "planes"),
        ({"planes_mm": [1.0, 1.0]}, "planes"),
        ({"planes_mm": [np.nan]}, "planes"),
        ({"planes_mm": "top"}, "planes"),
    ],
)
def test_refuses_what_cannot_be_sampled(options, message):
    with pytest.raises(InputError, match=message):
        evaluate(MACRO, TABLE_4, **options)
