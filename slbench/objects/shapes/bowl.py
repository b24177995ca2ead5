"""A bowl: a spherical cap sunk into a square plate, whose wall lights itself.

It is the cap of :mod:`slbench.objects.shapes.microlens` upside down.  Light that is reflected
inside a spherical bowl reaches all of it evenly (the integrating sphere), so that interreflection
is strong and known.

Parts: ``bowl`` (the cap) and ``plate``.  Object frame: origin at the middle of the rim; z = 0 on
the plate's top face.
"""

from slbench.core.validation.types import Length, Positive
from slbench.objects.artefact import Artefact
from slbench.objects.registry import ArtefactKind
from slbench.objects.shapes.microlens import MicroLensParameters, cap_on_plate, measure_cap


class BowlParameters(MicroLensParameters):
    """Size of a bowl and fineness of its mesh.

    Parameters
    ----------
    radius_of_curvature_mm : float
        Radius of the sphere.
    aperture_mm : float
        Diameter of the rim; less than 1.9 radii of curvature.
    plate_mm : float
        Side of the plate; at least 1.1 apertures.
    thickness_mm : float
        Extent below z = 0; more than the depth.
    max_form_error_um : float
        Largest distance of the bowl from the certified sphere.
    """

    radius_of_curvature_mm: Length = 20.0
    aperture_mm: Length = 36.0
    plate_mm: Length = 50.0
    thickness_mm: Length = 15.0
    max_form_error_um: Positive = 2.0


def build_bowl(parameters: BowlParameters, name: str, where: str) -> Artefact:
    """Build a bowl.

    Parameters
    ----------
    parameters : BowlParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the features ``reference``, a strip of the plate at -y, and ``sphere``;
        certified are the sphere's diameter and the rim's, the size along x and y, and the
        flatness of the plate.

    Raises
    ------
    InputError
        If the bowl is nearly a hemisphere or more, does not fit the plate, reaches its bottom, or
        no mesh of reasonable size keeps the form error.
    """
    return cap_on_plate(parameters, "bowl", "bowl", -1.0, name, where)


def measure_bowl(artefact: Artefact) -> dict[str, float]:
    """Measure the bowl from the faces of the part ``bowl``.

    Parameters
    ----------
    artefact : Artefact
        A bowl.

    Returns
    -------
    dict of str to float
        ``sphere_diameter_mm``, twice the mean distance of the bowl's facets from the centre,
        and ``aperture_mm``, twice that of its points at z = 0 from the axis.
    """
    return measure_cap(artefact, "bowl")


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(BowlParameters, build_bowl, measure_bowl)
