"""Errors of acceptance tests on known points: closed forms, brute force, repeated draws."""

from __future__ import annotations

import functools
import re
from dataclasses import replace

import numpy as np
import pytest

import slbench as sl
from slbench.bench.accept.acceptance import _samples_doubt, assembled, planned
from slbench.bench.accept.definitions import LEAST_PLACES, TESTS
from slbench.bench.accept.evaluate import Place, PlaceError, measured_place
from slbench.bench.accept.plan import plan
from slbench.bench.accept.signatures import explain, parameters_of, seen_by, signature
from slbench.bench.accept.standards import Standard, Temperature, usual_standard
from slbench.bench.accept.surfaces import Points, fit_plate, lines_of, thinnest
from slbench.bench.accept.verdict import Limit, judge, judged_tests, overall, read_limits
from slbench.core.errors import InputError
from slbench.rig import Pose, Rig
from slbench.rig.parameters import moved
from slbench.scene.file import load_scene
from slbench.score.residuals import trimmed_range

SPHERE = Standard("sphere", diameter_mm=10.0)
BAR = Standard("ball_bar", diameter_mm=10.0, spacing_mm=40.0)
PLATE = Standard("plane", size_mm=(40.0, 50.0))


def cap(rng: np.random.Generator, centre: tuple[float, ...], radius: float, count: int = 600):
    """Points of a ball's upper cap, up to 60 degrees from the z axis, and their normals."""
    z = 1.0 - 0.5 * rng.random(count)
    around = 2.0 * np.pi * rng.random(count)
    across = np.sqrt(1.0 - z * z)
    normals = np.column_stack((across * np.cos(around), across * np.sin(around), z))
    return np.array(centre) + radius * normals, normals


def noise_along(normals, sigma: float):
    """One standard deviation along the normals, as a cloud has it along its rays."""
    return sigma * normals[:, None, :]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_scene("plane").rig


def test_sizes_of_exact_points_are_exact() -> None:
    """Rounding alone is left: 1e-9 mm is a picometre."""
    rng = np.random.default_rng(0)
    first, _ = cap(rng, (-20.0, 0.0, 1.0), 5.001)
    second, _ = cap(rng, (20.002, 0.0, 1.0), 5.002)
    bar = measured_place(Place("bar", BAR), [[Points(first), Points(second)]]).errors()
    assert bar["sphere_spacing"] == pytest.approx(0.002, abs=1e-9)
    # E = SD + (PS_1 + PS_2) / 2 = 2 + (2 + 4) / 2 um
    assert bar["length"] == pytest.approx(0.005, abs=1e-9)
    ball = measured_place(Place("ball", SPHERE), [[Points(first)]]).errors()
    assert ball["probing_size"] == pytest.approx(0.002, abs=1e-9)
    assert ball["probing_form"] < 1e-9
    assert ball["probing_dispersion"] < 1e-9


def test_form_is_the_range_after_three_in_a_thousand_are_set_aside() -> None:
    residuals = np.concatenate((np.linspace(-1.0, 2.0, 997), [50.0, -40.0, 30.0]))
    assert trimmed_range(residuals, 0.003) == pytest.approx(3.0)
    assert trimmed_range(residuals, 0.002) == pytest.approx(31.0)  # one gross point is left


def test_thinnest_shell_equals_brute_force() -> None:
    rng = np.random.default_rng(3)
    for count in (20, 57, 300):
        residuals = rng.gamma(2.0, size=count)
        inside = int(np.ceil(0.95 * count))
        ordered = np.sort(residuals)
        brute = min(
            high - low
            for low in ordered
            for high in ordered
            if np.sum((residuals >= low) & (residuals <= high)) >= inside and high >= low
        )
        assert thinnest(residuals, 0.95) == pytest.approx(brute, abs=1e-12)


def test_plate_is_fitted_by_orthogonal_distances() -> None:
    """A plate bent into a parabola of known sag, tilted: its range does not depend on the tilt."""
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41)))
    flat = np.column_stack((20.0 * x, 25.0 * y, 0.01 * x * x))
    turn = Pose.looking_at([0.0, 0.0, 0.0], [0.3, 0.2, 0.9], [0.0, 1.0, 0.0]).rotation
    ranges = [fit_plate(Points(p), "plate").form_mm for p in (flat, flat @ turn.T + 7.0)]
    assert ranges[0] == pytest.approx(ranges[1], abs=1e-9)
    assert ranges[0] == pytest.approx(0.01, rel=1e-6)  # less than 0.3 % of 1681 are extreme


def test_stated_uncertainties_are_the_deviations_of_repeats() -> None:
    """Of 400 repeats a standard deviation is known to 3.5 %: four of that, and 5 % of the draws.

    Noise is 2 um along the normals, on a surface that is 3 um out of round.
    """
    rng = np.random.default_rng(8)
    points, normals = cap(rng, (0.0, 0.0, 0.0), 5.0)
    points = (
        points + (0.003 * np.cos(3.0 * np.arctan2(normals[:, 1], normals[:, 0])))[:, None] * normals
    )
    other, turned = cap(rng, (40.0, 0.0, 0.0), 5.0)
    kinds = {"ball": [], "bar": []}
    for _ in range(400):
        noisy = [
            Points(p + 0.002 * rng.standard_normal((len(p), 1)) * n, noise_along(n, 0.002))
            for p, n in ((points, normals), (other, turned))
        ]
        kinds["ball"].append(measured_place(Place("ball", SPHERE), [noisy[:1]]).values())
        kinds["bar"].append(measured_place(Place("bar", BAR), [noisy]).values())
    for rows in kinds.values():
        for values in zip(*rows, strict=True):
            spread = np.std([value.error_mm for value in values], ddof=1)
            stated = np.sqrt(np.mean([value.u_test_mm**2 for value in values]))
            assert stated == pytest.approx(spread, rel=4.0 * 0.035 + 0.05), values[0].test


def test_calibrations_scatter_of_a_range_is_that_of_its_draws() -> None:
    """A flat plate bends by ``b x`` with a calibration's error x: its range is ``b |x|``."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-20.0, 20.0, (2, 2000))
    bend = np.column_stack((0.0 * x, 0.0 * x, 1e-3 * (x / 20.0) ** 2))
    flat = np.column_stack((x, y, 0.0 * x))
    (flatness, _) = measured_place(Place("plate", PLATE), [[Points(flat)]]).values([[bend]])
    drawn = [
        measured_place(Place("plate", PLATE), [[Points(flat + t * bend)]]).errors()["flatness"]
        for t in rng.standard_normal(400)
    ]
    # Of 400 draws a deviation is known to 3.5 %, times three.
    assert flatness.u_calibration_mm == pytest.approx(np.std(drawn), rel=0.11)
    bent = Points(flat + 3.0 * bend)  # where the range is linear: b itself
    (flatness, _) = measured_place(Place("plate", PLATE), [[bent]]).values([[bend]])
    # Its own normals differ from the flat plate's by 1e-4; points at the ends count one by one.
    assert flatness.u_calibration_mm == pytest.approx(flatness.error_mm / 3.0, rel=1e-3)


def test_without_predicted_noise_the_scatter_tells_the_uncertainty() -> None:
    """The same by residuals, whose own deviation is known to 3 % from 600 points."""
    rng = np.random.default_rng(4)
    points, normals = cap(rng, (0.0, 0.0, 0.0), 5.0)
    rows = []
    for _ in range(300):
        noisy = Points(points + 0.002 * rng.standard_normal((len(points), 1)) * normals)
        rows.append(measured_place(Place("ball", SPHERE), [[noisy]]).values()[2])
    assert rows[0].test == "probing_size"
    spread = np.std([value.error_mm for value in rows], ddof=1)
    assert np.mean([v.u_test_mm for v in rows]) == pytest.approx(spread, rel=4.0 * 0.041)


def test_certificate_and_temperature_shift_errors_and_widen_them() -> None:
    rng = np.random.default_rng(1)
    parts = [Points(cap(rng, (x, 0.0, 0.0), 5.0)[0]) for x in (-20.0, 20.0)]
    errors = measured_place(Place("bar", BAR), [parts]).errors()
    off = replace(BAR, spacing_mm=40.0 + 0.0015)
    shifted = measured_place(Place("bar", off), [parts]).errors()
    for name in ("sphere_spacing", "length"):
        assert shifted[name] - errors[name] == pytest.approx(-0.0015, abs=1e-9)
    warm = replace(
        BAR,
        expansion_per_K=11.5e-6,
        u_expansion_per_K=1e-6,
        spacing_U_um=0.8,
        temperature=Temperature(22.0, 0.5),
    )
    value = measured_place(Place("bar", warm), [parts]).values()[0]
    # Grown by 40 mm x 11.5e-6 x 2; u by half a kelvin, and by 1e-6 x 2 of the expansion.
    assert value.error_mm - errors["sphere_spacing"] == pytest.approx(-40.0 * 23e-6, abs=1e-9)
    expected = 40.0 * (1 + 23e-6) * np.hypot(11.5e-6 * 0.5, 1e-6 * 2.0)
    parts = [value.u_mm["temperature"], value.u_mm["expansion"]]
    assert np.hypot(*parts) == pytest.approx(expected)
    # What another measurement with this certificate and coefficient does not share.
    repeated = np.hypot(value.u_mm["fit"], parts[0])
    assert value.u_repeat_mm == pytest.approx(repeated)
    assert value.u_mm["certificate"] == pytest.approx(0.0004)


def _value(error_um: float, u_um: float) -> PlaceError:
    return PlaceError("sphere_spacing", "bar 1", 1e-3 * error_um, 40.0, 40.0, {"fit": 1e-3 * u_um})


@pytest.mark.parametrize(
    ("error_um", "outcome"),
    # The limit of 40 mm is 10 + 40 / 20 = 12 um, the guard band 1.645 um.
    [(10.3, "pass"), (-10.3, "pass"), (10.4, "undecided"), (-13.6, "undecided"), (13.7, "fail")],
)
def test_verdicts_keep_a_guard_band(error_um: float, outcome: str) -> None:
    assert judge(_value(error_um, 1.0), Limit(10.0, 20.0)).outcome == outcome


@pytest.mark.parametrize(
    ("error_um", "u_um", "outcome"),
    # Probability within +-12 um: of u = 6 um, 95.4 % at 0 and 94.2 % at 2 um; of u = 7 um, 91 % at
    # 0.  Of u = 1 mm it is 1 % at 0, which proves nothing of an instrument: beyond one of the two
    # limits it must be, 12 + 164 um.
    [
        (0.0, 6.0, "pass"),
        (2.0, 6.0, "undecided"),
        (0.0, 7.0, "undecided"),
        (0.0, 1000.0, "undecided"),
        (176.0, 100.0, "undecided"),
        (177.0, 100.0, "fail"),
        (12.0, 0.0, "pass"),
        (12.1, 0.0, "fail"),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_signed_error_has_two_limits(error_um, u_um, outcome, sign) -> None:
    assert judge(_value(sign * error_um, u_um), Limit(10.0, 20.0)).outcome == outcome


def test_a_range_has_one_limit() -> None:
    """1.645 deviations below it pass, as much above fail; nothing is below zero."""
    for error, outcome in ((1.7, "pass"), (1.8, "undecided"), (18.3, "fail"), (18.2, "undecided")):
        value = PlaceError("flatness", "plate", 1e-3 * error, 0.0, 0.0, {"fit": 5e-3})
        assert judge(value, Limit(10.0)).outcome == outcome, error


def test_the_worst_place_is_the_one_that_decides() -> None:
    """A place at half its limit that is hardly known decides before one at 0.8 of it."""
    values = [replace(_value(9.6, 0.1), place="near"), replace(_value(6.0, 8.0), place="unsure")]
    (tested,) = judged_tests(values, {"sphere_spacing": Limit(12.0)})
    assert [one.outcome for one in tested.judged] == ["pass", "undecided"]
    assert tested.worst.value.place == "unsure"


def test_the_standards_own_form_is_part_of_a_forms_uncertainty() -> None:
    """Half of the certified form, and half of its expanded uncertainty (k = 2)."""
    rng = np.random.default_rng(1)
    part = Points(cap(rng, (0.0, 0.0, 0.0), 5.0)[0])
    own = replace(SPHERE, form_um=4.0, form_U_um=1.0)
    values = {v.test: v for v in measured_place(Place("ball", own), [[part]]).values()}
    for name in ("probing_form", "probing_dispersion"):
        assert values[name].u_mm["certificate"] == pytest.approx(1e-3 * np.hypot(2.0, 0.5))
    assert values["probing_size"].u_mm["certificate"] == 0.0


def test_one_failure_fails_and_no_limit_judges_nothing() -> None:
    assert overall(["pass", "undecided", "fail"]) == "fail"
    assert overall(["pass", "undecided", "no limit"]) == "undecided"
    assert overall(["no limit", "pass"]) == "pass"
    assert judge(_value(1e6, 1.0), None).outcome == "no limit"


def test_limits_are_read_and_refused() -> None:
    found = read_limits({"sphere_spacing_um": "15 + L/50", "probing_size": 20.5}, "mpe.toml")
    assert found["sphere_spacing"].mm(100.0) == pytest.approx(0.017)
    assert found["probing_size"].mm(100.0) == pytest.approx(0.0205)
    for bad in ("15 - L/50", "L/50", "", "0", "15 + L/0", True, "15 + 1"):
        with pytest.raises(InputError, match="micrometres"):
            read_limits({"flatness": bad}, "mpe.toml")
    with pytest.raises(InputError, match="of a form, which has no length"):
        read_limits({"flatness": "15 + L/50"}, "mpe.toml")
    with pytest.raises(InputError, match=r"did you mean|probing_size"):
        read_limits({"probing_sise": 3}, "mpe.toml")


@pytest.mark.parametrize("kind", ["sphere", "ball_bar", "plane"])
def test_places_are_apart_seen_and_in_the_volume(rig: Rig, kind) -> None:
    standard = usual_standard(kind, rig.volume_mm)
    places = plan(rig, Pose(), standard)
    assert len(places) == LEAST_PLACES[kind]
    assert [p.poses for p in places] == [p.poses for p in plan(rig, Pose(), standard)]
    half = np.array(rig.volume_mm) / 2.0
    for place in places:
        mesh = place.standard.artefact()
        top = [f.centre_mm for f in mesh.spheres] if mesh.spheres else np.array(mesh.mesh.vertices)
        world = place.poses[0].to_world(np.array(top))
        world = world[world[:, 2] >= world[:, 2].max() - 1e3]
        if mesh.spheres:
            assert np.all(np.abs(world) <= half + 1e-9)
        for device in (rig.camera, rig.projector):
            assert device.contains(device.project(world)).all()
    gaps = [
        np.linalg.norm(a.poses[0].position - b.poses[0].position)
        + np.linalg.norm(a.poses[0].rotation - b.poses[0].rotation)
        for k, a in enumerate(places)
        for b in places[:k]
    ]
    assert min(gaps) > 0.1


def test_a_standard_too_large_for_the_volume_is_refused(rig: Rig) -> None:
    with pytest.raises(InputError, match="a smaller standard"):
        plan(rig, Pose(), Standard("sphere", diameter_mm=70.0))


def test_a_standard_has_the_sizes_of_its_kind() -> None:
    with pytest.raises(InputError, match="diameter_mm"):
        Standard("sphere", spacing_mm=40.0)
    with pytest.raises(InputError, match="spacing_mm"):
        Standard("ball_bar", diameter_mm=10.0)


@functools.cache
def _usual(kind) -> list[Place]:
    rig = load_scene("plane").rig
    return plan(rig, Pose(), usual_standard(kind, rig.volume_mm))


def _exact_places(rig: Rig, other: Rig):
    """Standards' true surface points through another rig, by their exact coordinates in this."""
    rng = np.random.default_rng(5)
    found = []
    for kind in ("sphere", "ball_bar", "plane"):
        for place in _usual(kind):
            pose, artefact = place.poses[0], place.standard.artefact()
            if kind == "plane":
                side = np.array(place.standard.size_mm) / 2.2
                local = [np.column_stack((rng.uniform(-side, side, (600, 2)), np.zeros(600)))]
                world = [pose.to_world(p) for p in local]
            else:
                middles = pose.to_world(np.array([b.centre_mm for b in artefact.spheres]))
                world = [cap(rng, m, artefact.spheres[0].radius_mm)[0] for m in middles]
            points = [Points(seen_by(rig, other, p, ("u",))) for p in world]
            found.append(measured_place(place, [points]))
    return found


def test_a_longer_baseline_is_a_similarity(rig: Rig) -> None:
    """All lengths from the camera grow with the baseline: sizes by 1e-3, forms by nothing.

    The camera stays and the projector's planes are carried along: exact, but for the turn that
    nothing makes.  To first order in 1e-3, so to 1e-3 of the errors.
    """
    unit, error = parameters_of(rig)["baseline"]
    assert unit == ""
    longer = moved(rig, {name: 1e-3 * value for name, value in error.items()})
    for measured in _exact_places(rig, longer):
        errors, standard = measured.errors(), measured.place.standard
        for name, value in errors.items():
            size = {
                "probing_size": standard.diameter_mm,
                "sphere_spacing": standard.spacing_mm,
                "length": (standard.spacing_mm or 0) + (standard.diameter_mm or 0),
            }.get(name, 0.0)
            assert value == pytest.approx(1e-3 * (size or 0.0), rel=2e-3, abs=1e-6)


def test_signature_is_the_derivative_of_what_another_rig_sees(rig: Rig) -> None:
    rng = np.random.default_rng(2)
    points, _ = cap(rng, (5.0, 3.0, 2.0), 7.0)
    for name, (unit, error) in parameters_of(rig).items():
        small = {"px": 1e-3, "rad": 1e-6, "": 1e-5}[unit]
        there = seen_by(rig, moved(rig, {k: small * v for k, v in error.items()}), points, ("u",))
        own = signature(rig, points, ("u",), unit, error)
        # Second order in a step that small is below 1e-3 of the first, rounding below 1e-9 mm.
        off = np.abs((there - points) - small * own).max()
        assert off <= 1e-3 * np.abs(small * own).max() + 1e-9, name


@pytest.mark.parametrize(
    ("name", "amount"),
    [("baseline", 1e-3), ("projector.cx_px", 0.5), ("camera.k1", 0.1), ("projector.k1", 0.3)],
)
def test_the_wrong_parameter_explains_exact_errors_best(rig: Rig, name: str, amount: float) -> None:
    """Of exact points, all but second order is explained: 1 % of the amount, 99 % of the errors."""
    _, error = parameters_of(rig)[name]
    wrong = moved(rig, {key: amount * value for key, value in error.items()})
    best = explain(wrong, _exact_places(rig, wrong), ("u",))[0]
    assert best.name == name
    assert best.amount == pytest.approx(amount, rel=0.01)
    assert best.share > 0.99


def test_every_test_has_a_symbol() -> None:
    for test in TESTS.values():
        assert test.label(1)
        assert "CMV.MV" in test.label(3) or not test.iso


def test_lines_follow_the_fringes() -> None:
    """Errors go together along the panel's columns where u is coded, along its rows where v is."""
    pixels = np.array([[3, 7], [4, 8]])
    assert lines_of(pixels).tolist() == lines_of(pixels, ("u", "v")).tolist() == [3, 4]
    assert lines_of(pixels, ("v",)).tolist() == [7, 8]


def test_errors_that_go_together_along_lines_widen_what_a_fit_says() -> None:
    """A line has one error of 5 um, points of their own 1 um: by points apart 1.96 u would hold
    some 60 %.  Of 100 draws a share of 95 % is known to 2.2 %, three of which are 6.6 %."""
    rng, held, apart = np.random.default_rng(3), [], []
    for _ in range(100):
        points, normals = cap(rng, (0.0, 0.0, 0.0), 5.0)
        lines = np.floor(8.0 * points[:, 0]).astype(int)
        off = 0.005 * rng.standard_normal(200)[lines - lines.min()]
        off += 0.001 * rng.standard_normal(len(points))
        moved_ = points + off[:, None] * normals
        for known, found in ((lines, held), (None, apart)):
            place = measured_place(Place("ball", SPHERE), [[Points(moved_, None, known)]])
            (size,) = (value for value in place.values() if value.test == "probing_size")
            found.append(abs(size.error_mm) <= 1.96 * size.u_mm["fit"])
    assert np.mean(held) > 0.95 - 0.066
    assert np.mean(apart) < 0.8


def test_an_acceptance_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="places: expected at least one, got none"):
        assembled("nothing", [])
    with pytest.raises(InputError, match="places: expected at least one, got none"):
        sl.accept(load_scene("acceptance-macro", preview=True), [])


@pytest.mark.parametrize("name", ["acceptance-macro", "acceptance-micro"])
@pytest.mark.parametrize("preview", [False, True])
def test_as_many_places_are_planned_as_the_guideline_asks_for(name: str, preview: bool) -> None:
    kinds = [place.standard.kind for place in planned(load_scene(name, preview=preview))]
    assert {kind: kinds.count(kind) for kind in kinds} == {"sphere": 10, "ball_bar": 7, "plane": 6}


def test_the_table_tells_of_too_few_places_where_there_are_too_few_alone() -> None:
    """And shows no count that is not its own."""
    rng = np.random.default_rng(1)
    ball = Points(cap(rng, (0.0, 0.0, 0.0), 5.0)[0])
    few = [measured_place(Place(f"ball {k}", SPHERE), [[ball]]) for k in range(2)]
    enough = [measured_place(Place(f"ball {k}", SPHERE), [[ball]]) for k in range(10)]
    limits = {"probing_size": Limit(50.0)}
    notes = [assembled("ball", part, limits=limits).table().note for part in (few, enough)]
    assert "fewer places" in notes[0]
    assert "fewer places" not in notes[1]
    assert not any("2 of 7" in note for note in notes)


def test_no_more_is_set_aside_than_the_guideline_allows() -> None:
    """0.3 % of 300 points are none, of 1,000 three; of 57 points 5 % are two, not three."""
    assert trimmed_range(np.array([5.0, *np.zeros(299)])) == 5.0
    assert trimmed_range(np.array([5.0, 5.0, 5.0, *np.zeros(997)])) == 0.0
    assert trimmed_range(np.array([5.0, 5.0, 5.0, 4.0, *np.zeros(996)])) == 4.0
    assert thinnest(np.array([5.0, 5.0, *np.zeros(55)]), 0.95) == 0.0
    assert thinnest(np.array([5.0, 5.0, 4.0, *np.zeros(54)]), 0.95) == 4.0
    # As many points as make 0.95 n whole: n / 20 are left out, whatever the rounding.
    for n in range(20, 2001, 20):
        many = np.zeros(n)
        many[: n // 20] = 5.0
        assert thinnest(many, 0.95) == 0.0, n
        many[n // 20] = 4.0
        assert thinnest(many, 0.95) == 4.0, n


def test_samples_that_leave_a_form_undecided_are_told() -> None:
    """Residuals of 10 um that samples would change by as much; if they decide nothing, no word."""
    rng = np.random.default_rng(4)
    points, normals = cap(rng, (0.0, 0.0, 0.0), 5.0)
    rough = Points(
        points + noise_along(normals, 0.010)[:, 0] * rng.standard_normal((600, 1)),
        noise_along(normals, 1e-4),
        sampling_mm=0.010 * rng.standard_normal((600, 1)) * normals,
    )
    places = [measured_place(Place(f"ball {k}", SPHERE), [[rough]]) for k in range(10)]
    form = places[0].errors()["probing_form"]
    near, far = ({"probing_form": Limit(1e3 * factor * form)} for factor in (1.1, 10.0))
    doubts = [_samples_doubt(assembled("ball", places[:n], limits=near)) for n in (10, 2)]
    assert re.search(r"sampling makes .* of probing form: more samples", doubts[0] or "")
    # Of two places it is the places that are too few.  Signed tests tell where samples are most.
    for found in (doubts[1], _samples_doubt(assembled("ball", places, limits=far))):
        assert "probing form" not in (found or "")
