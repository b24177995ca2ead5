"""Samples of a surface: where they are, how even, and in which patches."""

import numpy as np
import pytest
from view_parts import L_WIDTH, l_block

from slbench import objects
from slbench.core.errors import InputError
from slbench.objects import Mesh
from slbench.simulate.viewpoints.samples import patches_of, sample_surface


def test_samples_are_on_their_faces_and_even_by_area():
    mesh = objects.load_artefact("engine-block").mesh
    samples = sample_surface(mesh, 20_000)
    corners = mesh.vertices[mesh.faces[samples.faces]]
    off = np.sum((samples.points - corners[:, 0]) * samples.normals, axis=1)
    assert np.abs(off).max() < 1e-9
    # Barycentric coordinates are none below zero.
    edges = np.stack((corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=2)
    shares = np.linalg.pinv(edges) @ (samples.points - corners[:, 0])[..., np.newaxis]
    assert shares.min() > -1e-6
    assert shares.sum(axis=1).max() < 1.0 + 1e-6
    # Steps along the summed area: no face has a sample more or less than its area asks for.
    areas = mesh.face_areas
    counts = np.bincount(samples.faces, minlength=len(areas))
    assert np.abs(counts - areas / samples.area_mm2).max() <= 1.0
    assert np.isclose(samples.area_mm2 * len(samples), areas.sum())


def test_samples_of_a_large_face_fill_it_evenly():
    samples = sample_surface(l_block().mesh, 20_000)
    floor = (samples.normals[:, 2] > 0.5) & (np.abs(samples.points[:, 2] + 10.0) < 1e-9)
    points = samples.points[floor]
    # The floor is 30 x 30 mm: 9 of the cells of 10 x 10 mm have as many each.
    cells = np.floor((points[:, :2] - (-10.0, -L_WIDTH / 2)) / 10.0).astype(int)
    counts = np.bincount(3 * cells[:, 0] + cells[:, 1], minlength=9)
    expected = 100.0 / samples.area_mm2
    # The R2 sequence has a discrepancy of some log(n) / n; at random it would be 5 %.
    assert np.abs(counts / expected - 1.0).max() < 0.05


def test_patches_hold_neighbours_of_one_side():
    samples = sample_surface(objects.load_artefact("brick").mesh, 5000)
    patch = patches_of(samples, 400)
    assert patch.min() == 0
    assert len(np.unique(patch)) == patch.max() + 1 <= 400
    size = np.ptp(samples.points, axis=0).max()
    for one in range(patch.max() + 1):
        own = patch == one
        axis = np.argmax(np.abs(samples.normals[own]), axis=1)
        assert np.all(axis == axis[0])
        assert np.ptp(samples.points[own], axis=0).max() < 0.2 * size


def test_few_patches_are_the_six_sides():
    samples = sample_surface(l_block().mesh, 1000)
    assert patches_of(samples, 6).max() == 5


def test_a_mesh_without_area_is_refused():
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match="a face with an area"):
        sample_surface(flat, 100)
