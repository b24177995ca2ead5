"""What the tests of the macro-scale artefacts share: fresh builds, and closed solids."""

import manifold3d
import numpy as np
import pytest

from slbench import objects
from slbench.core import io, resources
from slbench.core.errors import InputError
from slbench.core.validation.values import validated


def fresh(kind, parameters, where="parameters"):
    """Build past the cache."""
    row = objects.artefacts.get(kind)
    return row.build(validated(row.parameters, parameters, where), kind, where)


def check_solid(mesh, genus=0):
    """Closed, one piece with `genus` handles, outward, no face without area or twice."""
    edges = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    code = edges[:, 0] * len(mesh.vertices) + edges[:, 1]
    twin = edges[:, 1] * len(mesh.vertices) + edges[:, 0]
    assert len(np.unique(code)) == len(code)
    assert np.array_equal(np.sort(code), np.sort(twin))
    assert mesh.volume > 0
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    # Far above the rounding of an area (1e-16 of the largest), far below any real facet.
    assert mesh.face_areas.min() > 1e-14 * mesh.face_areas.max()
    euler = len(mesh.vertices) - len(edges) // 2 + len(mesh.faces)
    assert euler == 2 - 2 * genus


def solid(mesh):
    """The mesh in the hands of an independent kernel, in the sense of its queries."""
    body = manifold3d.Manifold(
        manifold3d.Mesh64(mesh.vertices.copy(), mesh.faces.astype(np.uint64))
    )
    assert body.status() == manifold3d.Error.NoError
    return body


def check_repeatable(kind, parameters):
    """Same parameters, same bytes, whatever was built in between."""
    first = fresh(kind, parameters)
    fresh("ball_bar", BALL_BAR)
    again = fresh(kind, parameters)
    assert first.mesh.vertices.tobytes() == again.mesh.vertices.tobytes()
    assert first.mesh.faces.tobytes() == again.mesh.faces.tobytes()
    assert list(first.parts) == list(again.parts)
    for name, part in first.parts.items():
        assert np.array_equal(part, again.parts[name])


def check_shipped(name):
    """Certified as measured, to a nanometre, within 60 x 70 x 30 mm; return the artefact."""
    artefact = objects.load_artefact(name)
    stated = io.read_toml(resources.find("objects", name))["certified"]
    measured = objects.measure(artefact)
    assert stated
    for key, value in stated.items():
        assert measured[key] == pytest.approx(value, abs=1e-6), key
    assert set(artefact.certified) <= set(measured)
    assert (np.ptp(artefact.mesh.bounds, axis=0) < [60.0, 70.0, 30.0]).all()
    return artefact


def check_refused(kind, parameters, change, key):
    """One line that names the place and the key."""
    fresh(kind, parameters)
    with pytest.raises(InputError, match=key) as caught:
        fresh(kind, {**parameters, **change}, "scene.toml: object")
    assert str(caught.value).startswith("scene.toml: object")
    assert "\n" not in str(caught.value)


#: Coarse, and so quick to build.
BALL_BAR = {
    "spacing_mm": 40.0,
    "ball_diameter_mm": 10.0,
    "stem_diameter_mm": 3.0,
    "stem_length_mm": 3.0,
    "bar_width_mm": 8.0,
    "bar_height_mm": 4.0,
    "max_form_error_um": 20.0,
}
