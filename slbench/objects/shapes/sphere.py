"""A sphere: the artefact for probing-form and probing-size scores.

The mesh is an icosphere (a subdivided icosahedron, its vertices on one sphere).  Flat facets
lie inside that sphere, so its radius is chosen a little larger than the certified one: such
that the mesh *encloses exactly the volume of the certified sphere*.  The mean radial
deviation, weighted by solid angle, is then zero to second order in the sag, and a
least-squares sphere through points all over the mesh has the certified radius.

Vertices stand out by 3/8 and facet middles lie inside by 1/8 of the square of a facet's
angular circumradius, times the radius; the subdivision is the coarsest for which the larger
stays within the stated form error.

Object frame: origin at the centre of the sphere.
"""

import functools
import math

import numpy as np
import trimesh
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Length, Positive
from slbench.objects.artefact import Artefact, Mesh, SphereFeature
from slbench.objects.registry import ArtefactKind

#: 1.3 million facets.  The form error of the next would be below single precision's grain.
_FINEST = 8


class SphereParameters(Parameters):
    """Size of a sphere and fineness of its mesh.

    Parameters
    ----------
    radius_mm : float
        Certified radius.
    max_form_error_um : float
        Largest distance of the mesh from the certified sphere.
    """

    radius_mm: Length
    max_form_error_um: Positive = 0.5


def build_sphere(parameters: SphereParameters, name: str, where: str) -> Artefact:
    """Build a sphere.

    Parameters
    ----------
    parameters : SphereParameters
        Its radius and the form error allowed.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the one feature ``sphere``; certified is its diameter.

    Raises
    ------
    InputError
        If no mesh of reasonable size keeps the form error.
    """
    radius = parameters.radius_mm
    allowed = 1e-3 * parameters.max_form_error_um / radius
    for subdivisions in range(_FINEST + 1):
        vertices, faces, form_error = _unit_icosphere(subdivisions)
        if form_error <= allowed:
            break
    else:
        expected = f"at least {1e3 * form_error * radius:.3g} for a radius of {radius:g} mm"
        raise InputError(f"{where}.max_form_error_um", expected, parameters.max_form_error_um)
    return Artefact(
        name=name,
        kind="sphere",
        parameters=parameters.model_dump(),
        mesh=Mesh(radius * vertices, faces),
        certified={"sphere_diameter_mm": 2.0 * radius},
        features=(SphereFeature("sphere", (0.0, 0.0, 0.0), radius),),
    )


# Every radius is a scaled copy of one of these; finding the subdivision visits them in turn.
@functools.lru_cache(maxsize=_FINEST + 1)
def _unit_icosphere(
    subdivisions: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64], float]:
    """Icosphere with the volume of the unit sphere, and its largest deviation from it."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    faces = np.asarray(sphere.faces, dtype=np.int64)
    unit = Mesh(sphere.vertices, faces)
    vertices = unit.vertices * math.cbrt(4.0 / 3.0 * math.pi / unit.volume)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    nearest = np.einsum("ij,ij->i", normals, a) / np.linalg.norm(normals, axis=1)
    outwards = np.linalg.norm(vertices, axis=1).max() - 1.0
    return vertices, faces, float(max(outwards, 1.0 - nearest.min()))


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(SphereParameters, build_sphere)
