"""The model as a value: predictions, domain, uncertainty, files."""

import json
import tracemalloc

import numpy as np
import pytest
from calibration_data import rig_points

from slbench.calibration.apply import measure
from slbench.calibration.models.domain import Domain
from slbench.calibration.models.model import CalibrationModel, CoordinateModel
from slbench.calibration.models.points import COLUMNS, CalibrationPoints
from slbench.calibration.models.polynomials import (
    VARIABLES,
    PolynomialForm,
    Standardisation,
    polynomial_form,
)
from slbench.calibration.selection import select_models
from slbench.core.errors import InputError
from slbench.patterns import PhaseMap

POINTS = rig_points(800, 0.05)
FOUND = select_models(POINTS)
MODEL = FOUND.model
INPUTS = POINTS.inputs()
EPS = np.finfo(np.float64).eps


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.json"
    MODEL.save(path)
    return path


class TestPrediction:
    def test_points(self):
        errors = MODEL.predict(INPUTS[FOUND.validation]) - POINTS.world[FOUND.validation]
        for k, name in enumerate("xyz"):
            expected = FOUND.final[name].validation_rms
            assert np.sqrt(np.mean(errors[:, k] ** 2)) == pytest.approx(expected, rel=1e-9)

    def test_long_inputs_are_the_same_as_short_ones(self):
        long = np.tile(INPUTS, (200, 1))  # several passes
        np.testing.assert_allclose(MODEL.predict(long)[-800:], MODEL.predict(INPUTS), atol=1e-13)
        assert MODEL.predict_std(long).shape == (160_000, 3)

    def test_deviation_covers_held_out_points(self):
        """95 % within 1.96 deviations, +/- 2 %: 30,000 numbers, a standard error below 0.3 %
        even were the three coordinates one (0.2 % at 10,000): 6 of it.
        """
        new = rig_points(10_000, 0.05, seed=1)
        found = select_models(rig_points(3000, 0.05, seed=2)).model
        t = (found.predict(new.inputs()) - new.world) / found.predict_std(new.inputs())
        assert np.mean(np.abs(t) < 1.96) == pytest.approx(0.95, abs=0.02)

    def test_deviation_grows_outside_the_domain(self):
        middle = INPUTS.mean(axis=0)
        far = middle + 3.0 * (INPUTS.max(axis=0) - middle)
        std = MODEL.predict_std(np.stack((middle, far)))
        assert np.all(std[1] > 2 * std[0])

    def test_gradient_is_the_derivative(self):
        gradient = MODEL.gradient(INPUTS[:20])
        for j in range(3):
            shift = 0.01 * np.eye(3)[j]
            change = MODEL.predict(INPUTS[:20] + shift) - MODEL.predict(INPUTS[:20] - shift)
            # Rounding of 1e-16 mm over 0.02 px.
            np.testing.assert_allclose(gradient[:, :, j], change / 0.02, atol=1e-12)

    def test_coefficients_in_pixels(self):
        raw = MODEL.raw_coefficients()
        for k, (name, one) in enumerate(zip("xyz", MODEL.coordinates, strict=True)):
            assert tuple(raw[name]) == one.form.terms
            values = one.form.design(INPUTS) @ list(raw[name].values())
            np.testing.assert_allclose(values, MODEL.predict(INPUTS)[:, k], atol=1e-9)

    @pytest.mark.parametrize("wrong", [np.ones((2, 4)), np.ones(3), [[1.0, np.nan, 2.0]], []])
    def test_wrong_inputs(self, wrong):
        for method in (MODEL.predict, MODEL.predict_std, MODEL.inside, MODEL.gradient):
            with pytest.raises(InputError, match="axes u"):
                method(wrong)


def form_of(name, axes):
    """Return a form of the table, or one that is not nested in them: the panel's square."""
    if name != "added":
        return polynomial_form(name, axes)
    rest = (0,) * (len(VARIABLES[axes]) - 3)
    terms = tuple((0, 0, power, *rest) for power in range(3))
    return PolynomialForm(name, VARIABLES[axes], terms)


def drawn_model(names, axes):
    """Return a model of any forms, with coefficients, covariances and standardisation drawn."""
    rng = np.random.default_rng(5)
    inputs = POINTS.inputs(axes)
    coordinates = []
    for name in names:
        form = form_of(name, axes)
        root = rng.normal(size=(len(form), len(form)))
        coordinates.append(
            CoordinateModel(form, rng.normal(size=len(form)), root @ root.T, rng.random())
        )
    standardisation = Standardisation.of(inputs, form.variables)
    domain = Domain.of(standardisation.apply(inputs))
    return CalibrationModel(axes, standardisation, tuple(coordinates), domain), inputs


class TestOnePass:
    """The compiled pass against the design matrix, which is scikit-learn's."""

    @pytest.mark.parametrize("axes", ["u", "uv"])
    @pytest.mark.parametrize(
        "names", [("M1", "M1", "M1"), ("M2", "M4", "M3"), ("M4", "M4", "M4"), ("M1", "added", "M2")]
    )
    def test_all_that_a_model_says(self, names, axes):
        model, inputs = drawn_model(names, axes)
        rows = np.resize(inputs, (1000 + 37, inputs.shape[1]))  # whole blocks and a rest
        found = model.measure(rows)
        scaled = model.standardisation.apply(rows)
        for k, one in enumerate(model.coordinates):
            design = one.form.design(scaled)
            size = np.abs(design) @ np.abs(one.coefficients)
            # Sums of up to 35 products in another order: 35 roundings of the terms' sizes.
            bound = 35 * EPS * size
            assert np.all(np.abs(found.points[:, k] - design @ one.coefficients) <= bound)
            expected = np.einsum("ni,ij,nj->n", design, one.covariance, design)
            bound = (
                35 * EPS * np.einsum("ni,ij,nj->n", *map(np.abs, (design, one.covariance, design)))
            )
            variance = found.std[:, k] ** 2 - one.residual_std**2
            assert np.all(np.abs(variance - expected) <= bound + 4 * EPS * found.std[:, k] ** 2)
            slopes = one.form.derivatives(one.coefficients) / model.standardisation.scale[:, None]
            for j, slope in enumerate(slopes[2:]):
                bound = 35 * EPS * np.abs(design) @ np.abs(slope)
                error = found.sensitivity[:, j, k] - design @ slope
                assert np.all(np.abs(error) <= bound)
        np.testing.assert_array_equal(found.points, model.predict(rows))
        np.testing.assert_array_equal(found.std, model.predict_std(rows))
        gradient = model.gradient(rows)
        np.testing.assert_array_equal(np.moveaxis(found.sensitivity, 1, 2), gradient[:, :, 2:])
        np.testing.assert_array_equal(found.inside, model.inside(rows))

    def test_memory_is_that_of_the_results(self):
        rows = np.resize(INPUTS, (400_000, 3))
        tracemalloc.start()
        try:
            found = MODEL.measure(rows)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        results = found.points.nbytes + found.std.nbytes + found.sensitivity.nbytes
        # The mask, and masks of finite inputs beside it; design matrices would be 64 MB each.
        assert peak < results + 8 * len(rows)


class TestDomain:
    @pytest.mark.parametrize("order", ["rows", "drawn", "far"])
    def test_every_half_space_at_every_point(self, order):
        rng = np.random.default_rng(7)
        domain = Domain.of(rng.normal(size=(400, 3)))
        assert len(domain.half_spaces) > 50
        side = np.linspace(-3.0, 3.0, 60)
        points = np.stack(np.meshgrid(*[side] * 2, side[::8]), axis=-1).reshape(-1, 3)
        if order == "drawn":
            points = rng.permutation(points)
        elif order == "far":
            points = points * 10.0 ** rng.integers(-3, 12, (len(points), 1))
        normals, offsets = domain.half_spaces[:, :3], domain.half_spaces[:, 3]
        # Points on faces too: moved along their own by less and more than the tolerance of 1e-9.
        face = rng.integers(0, len(normals), len(points))
        middle = -offsets[face, None] * normals[face]
        beside = np.concatenate([middle + by * normals[face] for by in (-1e-8, 5e-10, 2e-9)])
        for some in (points, beside, rng.permutation(beside)):
            a, b, c = normals.T
            x, y, z = some[:, 0, None], some[:, 1, None], some[:, 2, None]
            expected = np.all(a * x + b * y + c * z + offsets <= 1e-9, axis=1)
            np.testing.assert_array_equal(domain.inside(some), expected)
            assert order == "far" or 0 < expected.sum() < len(some)

    def test_training_points_are_inside_and_others_are_not(self):
        assert MODEL.inside(INPUTS[FOUND.train]).all()
        far = INPUTS + 2 * np.ptp(INPUTS, axis=0)
        assert not MODEL.inside(far).any()

    def test_hull_of_a_box(self):
        corners = np.array(np.meshgrid([-1, 1], [-2, 2], [-3, 3])).reshape(3, 8).T
        rng = np.random.default_rng(0)
        domain = Domain.of(np.concatenate((corners, corners * 0.3)))
        assert len(domain.half_spaces) == 6  # triangulated faces merged
        some = rng.uniform(-4, 4, (5000, 3))
        expected = np.all(np.abs(some) < [1, 2, 3], axis=1)
        np.testing.assert_array_equal(domain.inside(some), expected)

    def test_inputs_without_a_hull_get_a_box(self):
        rng = np.random.default_rng(1)
        flat = rng.normal(size=(50, 2)) @ rng.normal(size=(2, 3))
        domain = Domain.of(flat)
        assert domain.inside(flat).all()
        normal = np.linalg.svd(flat)[2][2]
        assert not domain.inside(flat + 0.01 * normal).any()
        assert not domain.inside(flat * 100).all()


class TestFile:
    def test_round_trip_is_exact(self, saved, tmp_path):
        again = CalibrationModel.load(saved)
        np.testing.assert_array_equal(again.predict(INPUTS), MODEL.predict(INPUTS))
        np.testing.assert_array_equal(again.predict_std(INPUTS), MODEL.predict_std(INPUTS))
        np.testing.assert_array_equal(again.inside(INPUTS), MODEL.inside(INPUTS))
        assert again.axes == "u"
        again.save(tmp_path / "again.json")
        assert (tmp_path / "again.json").read_bytes() == saved.read_bytes()

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda d: d.update(version=2), "version"),
            (lambda d: d.update(version=True), "version"),
            (lambda d: d.update(kind="other"), "kind"),
            (lambda d: d.pop("axes"), "axes"),
            (lambda d: d.update(axes="uv"), "mean_px"),
            (lambda d: d.update(more=1), "more"),
            (lambda d: d["mean_px"].pop(), "mean_px"),
            (lambda d: d.update(scale_px=[1.0, -1.0, 1.0]), "scale_px"),
            (lambda d: d["mean_px"].__setitem__(0, None), r"mean_px\[0\]"),
            (lambda d: d["mean_px"].__setitem__(0, "1"), r"mean_px\[0\]"),
            (lambda d: d["coordinates"].pop("y"), "coordinates.y"),
            (lambda d: d["coordinates"]["z"].update(form="M1"), "coordinates.z.terms"),
            (lambda d: d["coordinates"]["z"].update(form="M9"), "coordinates.z.form"),
            (lambda d: d["coordinates"]["x"]["coefficients_mm"].pop(), "x.coefficients_mm"),
            (lambda d: d["coordinates"]["x"]["covariance_mm2"].pop(), "x.covariance_mm2"),
            (lambda d: d["coordinates"]["x"]["covariance_mm2"][0].pop(), "x.covariance_mm2"),
            (
                lambda d: d["coordinates"]["x"]["covariance_mm2"][0].__setitem__(0, -1.0),
                "x.covariance_mm2.*symmetric",
            ),
            (lambda d: d["coordinates"]["x"].update(residual_std_mm=-1.0), "residual_std_mm"),
            (lambda d: d.update(half_spaces=[]), "half_spaces"),
            (lambda d: d.update(half_spaces=[[1.0, 0.0, 0.0]]), "half_spaces"),
            (lambda d: d.update(half_spaces=[[9.0, 0.0, 0.0, 1.0]]), "half_spaces"),
        ],
    )
    def test_corrupt_files_are_refused(self, saved, tmp_path, change, words):
        content = json.loads(saved.read_text())
        change(content)
        path = tmp_path / "bad.json"
        path.write_text(json.dumps(content))
        with pytest.raises(InputError, match=words) as caught:
            CalibrationModel.load(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_other_files_are_refused(self, saved, tmp_path):
        path = tmp_path / "bad.json"
        for text in ("[]", "3", "{", saved.read_text()[:-200], ""):
            path.write_text(text)
            with pytest.raises(InputError, match=r"bad\.json"):
                CalibrationModel.load(path)
        with pytest.raises(InputError, match="nothing"):
            CalibrationModel.load(tmp_path / "none.json")


class TestPointsFile:
    def test_round_trip(self, tmp_path):
        POINTS.write(tmp_path / "points.csv")
        again = CalibrationPoints.read(tmp_path / "points.csv")
        np.testing.assert_allclose(again.pixels, POINTS.pixels, rtol=1e-8)  # nine digits
        np.testing.assert_allclose(again.world, POINTS.world, rtol=1e-8)

    def test_unknown_v_p_serves_one_axis_only(self, tmp_path):
        path = tmp_path / "points.csv"
        path.write_text(",".join(COLUMNS) + "\n1,2,3,nan,4,5,6\n")
        points = CalibrationPoints.read(path)
        np.testing.assert_array_equal(points.inputs("u"), [[1, 2, 3]])
        with pytest.raises(InputError, match="v_p"):
            points.inputs("uv")

    @pytest.mark.parametrize(
        "row", ["1,2,nan,3,4,5,6", "1,2,3,4,5,6,inf", "1,2,3,inf,4,5,6", "1,2,3", "1,2,3,,4,5,6"]
    )
    def test_bad_rows(self, tmp_path, row):
        path = tmp_path / "points.csv"
        path.write_text(",".join(COLUMNS) + "\n" + row + "\n")
        with pytest.raises(InputError, match=r"points\.csv"):
            CalibrationPoints.read(path)

    def test_wrong_arrays(self):
        with pytest.raises(InputError, match=r"\(n, 4\)"):
            CalibrationPoints(np.ones((3, 3)), np.ones((3, 3)))
        with pytest.raises(InputError, match="3 rows"):
            CalibrationPoints(np.ones((3, 4)), np.ones((2, 3)))


class TestMeasure:
    def phase(self, axes="u"):
        rng = np.random.default_rng(3)
        mask = rng.random((6, 8)) < 0.8
        some = {axis: np.where(mask, 500 + rng.random((6, 8)), np.nan) for axis in axes}
        sigma = {axis: np.where(mask, 0.02, np.nan) for axis in axes}
        return PhaseMap(some, sigma, np.ones((6, 8)), np.ones((6, 8)), mask, {})

    def test_points_and_their_deviation(self):
        phase = self.phase()
        found = measure(MODEL, phase)
        v, u = np.nonzero(phase.mask)
        inputs = np.column_stack((u, v, phase.coordinate["u"][v, u]))
        np.testing.assert_array_equal(found.cloud.points, MODEL.predict(inputs))
        np.testing.assert_array_equal(found.cloud.pixels, np.column_stack((u, v)))
        slope = MODEL.gradient(inputs)[:, :, 2]
        expected = np.sqrt(MODEL.predict_std(inputs) ** 2 + (0.02 * slope) ** 2)
        np.testing.assert_allclose(found.cloud.u_mm, expected, rtol=1e-12)
        np.testing.assert_allclose(found.cloud.sigma_mm, np.abs(0.02 * slope), rtol=1e-12)
        np.testing.assert_array_equal(found.extrapolated, ~MODEL.inside(inputs))
        assert len(found.inside().cloud) == MODEL.inside(inputs).sum()

    def test_axes(self):
        with pytest.raises(InputError, match="axes u coded"):
            measure(MODEL, self.phase("v"))
        assert len(measure(MODEL, self.phase("uv")).cloud) > 0

    def test_nothing_decoded(self):
        phase = self.phase()
        phase.mask[:] = False
        assert len(measure(MODEL, phase).cloud) == 0
