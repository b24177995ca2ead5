"""A flat plate: the artefact for noise, flatness and reference-plane scores.

Object frame: origin at the centre of the top face, which is the reference face, z = 0; the
plate lies below it.
"""

from typing import Annotated

from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import REFERENCE, Artefact, PlaneFeature
from slbench.objects.mesh.solids import prism
from slbench.objects.registry import ArtefactKind


class PlaneParameters(Parameters):
    """Size of a plate.

    Parameters
    ----------
    size_mm : (float, float)
        Extent along x and y.
    thickness_mm : float
        Extent along z.
    margin_fraction : float
        Width of the border left out of the fit, as a share of the size on either axis.
    """

    size_mm: tuple[Length, Length]
    thickness_mm: Length = 5.0
    margin_fraction: Annotated[float, Interval(ge=0.0, le=0.45)] = 0.05


def build_plane(parameters: PlaneParameters, name: str, where: str) -> Artefact:
    """Build a plate.

    Parameters
    ----------
    parameters : PlaneParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read (they are all valid here).

    Returns
    -------
    Artefact
        With the one feature ``reference``; certified are its size and its flatness.
    """
    x, y = parameters.size_mm
    bottom = -parameters.thickness_mm
    mesh = prism([(-x / 2, bottom), (x / 2, bottom), (x / 2, 0.0), (-x / 2, 0.0)], y)
    inner = 0.5 - parameters.margin_fraction
    face = PlaneFeature(REFERENCE, 0.0, 0.0, (-inner * x, inner * x), (-inner * y, inner * y))
    return Artefact(
        name=name,
        kind="plane",
        parameters=parameters.model_dump(),
        mesh=mesh,
        certified={"size_x_mm": x, "size_y_mm": y, "reference_flatness_um": 0.0},
        features=(face,),
    )


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(PlaneParameters, build_plane)
