"""Artefacts are closed solids of the stated size, and their dimensions can be measured back."""

import itertools
import math
import subprocess
import sys

import manifold3d
import numpy as np
import pytest
import scipy.optimize
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from slbench import objects
from slbench.core import io, resources
from slbench.core.errors import InputError
from slbench.objects import Mesh, PlaneFeature

SHIPPED = ["plane", "sphere", "step-block-5", "step-block-20"]
# Coordinates are differences and sums of a few parameters: some units in the last place.
ROUNDING = 1e-12

lengths = st.floats(0.01, 500.0)
heights_lists = st.lists(st.floats(0.01, 30.0), min_size=1, max_size=8).map(
    lambda rises: list(itertools.accumulate(rises))
)


def check_solid(mesh, min_relative_area=1e-12):
    """Closed, every edge once in each direction, outward, no face without area."""
    edges = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    code = edges[:, 0] * len(mesh.vertices) + edges[:, 1]
    twin = edges[:, 1] * len(mesh.vertices) + edges[:, 0]
    assert len(np.unique(code)) == len(code)
    assert np.array_equal(np.sort(code), np.sort(twin))
    assert mesh.is_watertight
    assert mesh.volume > 0
    assert mesh.face_areas.min() > min_relative_area * mesh.face_areas.max()
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    # Euler's formula: one piece without holes.
    assert len(mesh.vertices) - len(edges) // 2 + len(mesh.faces) == 2


# --- step block ---------------------------------------------------------------------------


@given(heights_lists, st.floats(0.1, 50.0), st.floats(1.0, 100.0), lengths)
def test_any_step_block_is_an_exact_solid(heights, step, width_in_steps, base):
    width = step * width_in_steps
    block = objects.build_artefact(
        "step_block",
        {"heights_mm": heights, "step_length_mm": step, "width_mm": width, "base_mm": base},
    )
    check_solid(block.mesh)
    # One volume a face: prisms side by side.
    closed_form = step * width * sum(base + height for height in [0.0, *heights])
    assert block.mesh.volume == pytest.approx(closed_form, rel=1e-11)
    length = step * (len(heights) + 1)
    low, high = [-length / 2, -width / 2, -base], [length / 2, width / 2, heights[-1]]
    np.testing.assert_allclose(block.mesh.bounds, [low, high], rtol=ROUNDING)

    measured = objects.measure(block)
    assert set(block.certified) <= set(measured)
    assert [step.height_mm for step in block.steps] == heights
    for i, height in enumerate(heights, start=1):
        # Picking the height up by barycentric weights rounds to 1e-13 of the tallest.
        assert measured[f"step_{i}_height_mm"] == pytest.approx(height, abs=1e-10)
    assert block.reference is not None
    assert (block.reference.z_mm, block.reference.height_mm) == (0.0, 0.0)


def test_step_faces_ascend_along_x_with_a_margin():
    block = objects.build_artefact(
        "step_block", {"heights_mm": [1, 2.5, 5], "step_length_mm": 14, "width_mm": 30}
    )
    faces = block.planes
    assert [face.name for face in faces] == ["reference", "step_1", "step_2", "step_3"]
    assert [face.z_mm for face in faces] == [0.0, 1.0, 2.5, 5.0]
    for i, face in enumerate(faces):
        # 15 % of 14 mm from each edge, by default.
        assert face.x_mm == pytest.approx((-28 + 14 * i + 2.1, -28 + 14 * (i + 1) - 2.1))
        assert face.y_mm == pytest.approx((-15 + 2.1, 15 - 2.1))


def test_step_interiors_lie_on_their_own_face():
    # An independent kernel cuts the block just under and just over each face: the cut loses
    # exactly the rectangle that the face occupies.
    block = objects.load_artefact("step-block-20")
    solid = manifold3d.Manifold(
        manifold3d.Mesh64(block.mesh.vertices.copy(), block.mesh.faces.astype(np.uint64))
    )
    assert solid.status() == manifold3d.Error.NoError
    assert solid.genus() == 0
    for face in block.planes:
        low_x, low_y, high_x, high_y = solid.slice(face.z_mm - 1e-3).bounds()
        if face is not block.planes[-1]:
            high_x = solid.slice(face.z_mm + 1e-3).bounds()[0]
        margin = 0.15 * 9.5
        # The cross-sections are kept on a grid of about 1e-8.
        assert face.x_mm == pytest.approx((low_x + margin, high_x - margin), abs=1e-6)
        assert face.y_mm == pytest.approx((low_y + margin, high_y - margin), abs=1e-6)
        places = np.random.default_rng(3).uniform(*np.transpose([face.x_mm, face.y_mm]), (50, 2))
        assert objects.surface_height(block.mesh, places) == pytest.approx(face.z_mm, abs=1e-12)
        assert face.contains(np.column_stack([places, np.full(50, 100.0)])).all()


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"heights_mm": [1.0, 1.0]}, "heights_mm"),
        ({"heights_mm": [2.0, 1.0]}, "heights_mm"),
        ({"width_mm": 4.0}, "width_mm"),
    ],
)
def test_refused_step_blocks(change, key):
    parameters = {"heights_mm": [1.0, 2.5], "step_length_mm": 14.0, "width_mm": 30.0}
    objects.build_artefact("step_block", parameters)
    with pytest.raises(InputError, match=key) as caught:
        objects.build_artefact("step_block", {**parameters, **change}, "scene.toml: object")
    assert str(caught.value).startswith("scene.toml: object")
    assert "\n" not in str(caught.value)


def test_heights_a_micrometre_apart_are_accepted():
    parameters = {"heights_mm": [1.0, 1.001], "step_length_mm": 14.0, "width_mm": 30.0}
    assert len(objects.build_artefact("step_block", parameters).steps) == 2


# --- plane --------------------------------------------------------------------------------


@given(lengths, lengths, lengths)
def test_any_plane_is_an_exact_slab(x, y, thickness):
    plate = objects.build_artefact("plane", {"size_mm": [x, y], "thickness_mm": thickness})
    # A sliver of a slab has faces of very unequal area: the smallest over the largest is
    # the shortest over the longest side, at the least.
    check_solid(plate.mesh, min_relative_area=1e-6)
    assert plate.mesh.volume == pytest.approx(x * y * thickness, rel=1e-11)
    expected = [[-x / 2, -y / 2, -thickness], [x / 2, y / 2, 0.0]]
    assert np.array_equal(plate.mesh.bounds, expected)
    measured = objects.measure(plate)
    assert measured["reference_flatness_um"] == 0.0
    assert plate.certified == {key: measured[key] for key in plate.certified}


@pytest.mark.parametrize(
    ("parameters", "key"),
    [
        ([1, 2], "a table"),
        (None, "a table"),
    ],
)
def test_refused_planes(parameters, key):
    with pytest.raises(InputError, match=key):
        objects.build_artefact("plane", parameters)


# --- sphere -------------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.floats(0.01, 200.0), st.floats(1e-3, 0.3))
def test_any_sphere_keeps_its_volume_and_form(radius, relative_form_error):
    bound_um = 1e3 * radius * relative_form_error
    ball = objects.build_artefact("sphere", {"radius_mm": radius, "max_form_error_um": bound_um})
    check_solid(ball.mesh)
    # The radius is balanced to enclose the certified volume; rounding over 1e5 terms.
    assert ball.mesh.volume == pytest.approx(4 / 3 * math.pi * radius**3, rel=1e-10)
    assert 1e3 * form_error(ball.mesh, radius) <= bound_um * (1 + 1e-9)
    # By mean square, deviations shift the mean radius by e^2 / R, in the second order.
    mean_diameter = objects.measure(ball)["sphere_diameter_mm"]
    assert mean_diameter == pytest.approx(2 * radius, rel=2 * relative_form_error**2 + 1e-12)


def form_error(mesh, radius):
    """Largest distance between mesh and sphere: a facet deviates most at a corner or middle."""
    corners = mesh.vertices[mesh.faces]
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], 30)
    inside = np.einsum("kc,mcd->mkd", np.vstack([weights, np.eye(3), np.full(3, 1 / 3)]), corners)
    return np.abs(np.linalg.norm(inside, axis=2) - radius).max()


def test_a_least_squares_sphere_through_the_surface_has_the_certified_radius():
    ball = objects.build_artefact("sphere", {"radius_mm": 12.5, "max_form_error_um": 10.0})
    rng = np.random.default_rng(11)
    weights = rng.dirichlet([1, 1, 1], 20_000)
    chosen = rng.choice(
        len(ball.mesh.faces), 20_000, p=ball.mesh.face_areas / ball.mesh.face_areas.sum()
    )
    points = np.einsum("kc,kcd->kd", weights, ball.mesh.vertices[ball.mesh.faces[chosen]])
    fit = scipy.optimize.least_squares(
        lambda p: np.linalg.norm(points - p[:3], axis=1) - p[3], [0.1, 0.1, 0.1, 12.0]
    )
    # The deviations (a standard deviation of about 3 um) average over 20,000 samples to
    # 0.02 um; five of these for the radius and each centre coordinate (x sqrt(3)): a false
    # alarm is below 1e-5, and the seed is fixed.
    deviation = np.std(np.linalg.norm(points, axis=1)) / math.sqrt(20_000)
    assert abs(fit.x[3] - 12.5) < 5 * deviation
    assert np.abs(fit.x[:3]).max() < 5 * math.sqrt(3) * deviation
    # Vertices alone lie outside by more than that: the balance is what makes it so.
    assert np.linalg.norm(ball.mesh.vertices, axis=1).min() - 12.5 > 50 * deviation


def test_the_coarsest_sufficient_mesh_is_chosen():
    counts = [
        len(objects.build_artefact("sphere", {"radius_mm": 1.0, "max_form_error_um": e}).mesh.faces)
        for e in (100.0, 10.0, 1.0)
    ]
    assert counts == sorted(counts)
    for count, error_um in zip(counts, (100.0, 10.0, 1.0), strict=True):
        if count > 20:
            coarser = trimesh.creation.icosphere(int(math.log(count / 20, 4)) - 1)
            scale = (4 / 3 * math.pi / coarser.volume) ** (1 / 3)
            mesh = Mesh(coarser.vertices * scale, coarser.faces)
            assert 1e3 * form_error(mesh, 1.0) > error_um * 0.99  # sampled facets, not exact


def test_a_form_error_beyond_reach_says_what_is_in_reach(monkeypatch):
    monkeypatch.setattr("slbench.objects.shapes.sphere._FINEST", 3)
    with pytest.raises(InputError, match=r"max_form_error_um: expected at least 2\.89 "):
        objects.build_artefact("sphere", {"radius_mm": 1.0, "max_form_error_um": 2.0})
    objects.build_artefact("sphere", {"radius_mm": 1.0, "max_form_error_um": 2.89})


def test_the_shipped_sphere_keeps_half_a_micrometre():
    mesh = objects.load_artefact("sphere").mesh
    outside = np.linalg.norm(mesh.vertices, axis=1) - 12.5
    inside = np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1), axis=1) - 12.5
    assert 0.0 < outside.min() <= outside.max() < 0.5e-3
    assert -0.5e-3 < inside.min() <= inside.max() < 0.0


# --- all kinds ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_artefacts_are_what_they_certify(name):
    artefact = objects.load_artefact(name)
    assert artefact.name == name
    assert artefact.source
    check_solid(artefact.mesh)
    stated = io.read_toml(resources.find("objects", name))["certified"]
    measured = objects.measure(artefact)
    assert stated
    assert artefact.certified == stated
    for key, value in stated.items():
        # A nanometre: what single-precision rendering would keep at this size.
        assert measured[key] == pytest.approx(value, abs=1e-6), key


@pytest.mark.parametrize("name", ["sphere", "step-block-5", "step-block-20"])
def test_small_artefacts_fit_the_measurement_volume(name):
    size = np.ptp(objects.load_artefact(name).mesh.bounds, axis=0)
    assert (size < [60.0, 70.0, 30.0]).all()


@pytest.mark.parametrize("name", SHIPPED)
def test_same_parameters_same_bytes(name):
    first, second = objects.load_artefact(name).mesh, objects.load_artefact(name).mesh
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()


def test_unknown_kind_names_the_known_ones():
    for kind in ["cube", "", None, ["plane"]]:
        with pytest.raises(InputError, match="plane, sphere, step_block, mesh"):
            objects.build_artefact(kind, {})


GOOD = """
kind = "step_block"
source = "a certificate"
[parameters]
heights_mm = [1.0]
step_length_mm = 5.0
width_mm = 5.0
[certified]
step_1_height_mm = 1.0
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "step_block"', 'kind = "cube"', "a.toml: kind: expected one of plane"),
        ("step_1_height_mm = 1.0", "step_1_height_mm = 1.00001", "certified.step_1_height_mm"),
        ("step_1_height_mm = 1.0", "step_2_height_mm = 1.0", "did you mean 'step_1_height_mm'"),
        ("[parameters]", "[parameters", "line 4, column 12"),
    ],
)
def test_refused_files(old, new, message, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(GOOD)
    assert objects.load_artefact(path).certified == {"step_1_height_mm": 1.0}
    assert old in GOOD
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        objects.load_artefact(path)
    assert "\n" not in str(caught.value)


# --- mesh and measurement -----------------------------------------------------------------

TETRAHEDRON = (np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_mesh_refuses_what_is_none():
    vertices, faces = TETRAHEDRON
    for bad in [
        (np.zeros((0, 3)), faces),
        (vertices[:, :2], faces),
        (np.where(vertices == 1, np.nan, vertices), faces),
        (np.where(vertices == 1, np.inf, vertices), faces),
        (vertices, np.zeros((0, 3), int)),
        (vertices, [[0, 1, 4]]),
        (vertices, [[0, 1, -1]]),
        (vertices, [[0.0, 1.0, 2.0]]),
        (vertices, [[0, 1, 2, 3]]),
    ]:
        with pytest.raises(InputError):
            Mesh(*bad)


def test_mesh_is_immutable_and_its_own():
    vertices, faces = TETRAHEDRON
    mine = vertices.copy()
    mesh = Mesh(mine, faces)
    mine[:] = 7.0
    assert np.array_equal(mesh.vertices, vertices)
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0, 0] = 1.0


@given(st.integers(0, 2**32 - 1))
def test_a_rigid_motion_keeps_the_volume(seed):
    rng = np.random.default_rng(seed)
    rotation, translation = trimesh.transformations.random_rotation_matrix(rng.random(3)), 300.0
    moved = Mesh(*TETRAHEDRON).transformed(rotation[:3, :3], np.full(3, translation))
    # 1/6 mm^3 at 500 mm from the origin: coordinates round to 6e-14, volume to about that.
    assert moved.volume == pytest.approx(1 / 6, rel=1e-11)
    expected = trimesh.transform_points(TETRAHEDRON[0], rotation) + translation
    np.testing.assert_allclose(moved.vertices, expected, atol=1e-12)


def test_what_is_no_rigid_motion_is_refused():
    mesh = Mesh(*TETRAHEDRON)
    for rotation, translation in [
        (2 * np.eye(3), np.zeros(3)),
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3)),
        (np.full((3, 3), np.nan), np.zeros(3)),
        (np.eye(4), np.zeros(3)),
        (np.eye(3), np.zeros(2)),
        (np.eye(3), [0.0, np.nan, 0.0]),
    ]:
        with pytest.raises(InputError):
            mesh.transformed(rotation, translation)


def test_measure_reads_the_mesh_and_not_the_parameters():
    # Vertices of one step lifted by 1 um: its height and nothing else must say so.
    block = objects.load_artefact("step-block-5")
    vertices = block.mesh.vertices.copy()
    vertices[vertices[:, 2] == 2.5, 2] += 1e-3
    measured = objects.measure(
        objects.Artefact(
            "lifted", "step_block", {}, Mesh(vertices, block.mesh.faces), {}, block.features
        )
    )
    assert measured["step_2_height_mm"] == pytest.approx(2.501, abs=1e-10)
    assert measured["step_1_height_mm"] == pytest.approx(1.0, abs=1e-10)
    # A face tilted by 2 um along its whole width deviates by 2 um x interior over width.
    vertices = block.mesh.vertices.copy()
    step = vertices[:, 2] == 2.5
    vertices[step, 2] += 1e-3 * np.sign(vertices[step, 1])
    tilted = objects.measure(
        objects.Artefact(
            "tilted", "step_block", {}, Mesh(vertices, block.mesh.faces), {}, block.features
        )
    )
    interior = block.steps[1].y_mm[1] - block.steps[1].y_mm[0]
    assert tilted["step_2_flatness_um"] == pytest.approx(2.0 * interior / 30.0, rel=1e-6)


def test_measure_says_nan_where_there_is_no_surface():
    mesh = objects.load_artefact("plane").mesh
    beside = PlaneFeature("reference", 0.0, 0.0, (60.0, 70.0), (0.0, 1.0))
    away = objects.SphereFeature("ball", (0.0, 0.0, 0.0), 1.0)
    measured = objects.measure(objects.Artefact("a", "plane", {}, mesh, {}, (beside, away)))
    assert math.isnan(measured["reference_flatness_um"])
    assert math.isnan(measured["ball_diameter_mm"])


def test_features_have_unique_names():
    face = PlaneFeature("reference", 0.0, 0.0, (0.0, 1.0), (0.0, 1.0))
    with pytest.raises(InputError, match="unique"):
        objects.Artefact("a", "plane", {}, Mesh(*TETRAHEDRON), {}, (face, face))


def test_points_that_are_nan_lie_over_no_face():
    face = PlaneFeature("reference", 0.0, 0.0, (0.0, 1.0), (0.0, 1.0))
    points = np.array([[[0.5, 0.5, 9.0], [np.nan, 0.5, 0.0]], [[1.5, 0.5, 0.0], [1, 1, 0]]])
    assert face.contains(points).tolist() == [[True, False], [False, True]]


def test_no_builder_is_imported_before_it_is_asked_for():
    code = (
        "import sys; from slbench import objects; names = objects.artefacts.names();"
        "print(len(names), [m for m in sys.modules if m.startswith('slbench.objects.')"
        " and m.count('.') > 2 and '.declared.' not in m])"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    count, found = output.stdout.split(maxsplit=1)
    assert int(count) >= 19, output.stderr
    assert found.strip() == "[]"


def test_the_kind_of_every_row_is_its_name():
    for name in objects.artefacts:
        row = objects.artefacts.get(name)
        assert row.build.__name__.startswith("build_"), name
        assert all(key in row.parameters.model_fields for key in row.files), name
