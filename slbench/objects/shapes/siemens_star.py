"""A star of raised spokes, whose period grows with the radius: for lateral resolution.

Spokes are sectors of half a period each, with upright flanks; the period at a radius r is 2 pi r /
n.  (Type ASG of ISO 25178-70 has such a star as grooves.)

Object frame: origin in the middle of the star, z = 0 on the plate between and around the spokes; a
spoke's middle lies along +x.
"""

from typing import Annotated

import manifold3d
import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import REFERENCE, Artefact, PlaneFeature
from slbench.objects.mesh.booleans import to_mesh
from slbench.objects.registry import ArtefactKind

#: Longest side of the chords of the outer and inner arcs, as a share of the radius: the arcs are
#: the ends of spokes, which nobody measures.
_CHORD = 0.02
_MARGIN = 0.15


class SiemensStarParameters(Parameters):
    """Size of a star.

    Parameters
    ----------
    spokes : int
        Periods around the star.
    inner_radius_mm, outer_radius_mm : float
        Where spokes begin and end.
    height_mm : float
        Of the spokes above the plate.
    rim_mm : float
        From the star to the edges of the square plate.
    base_mm : float
        Thickness of the plate.
    """

    spokes: Annotated[int, Interval(ge=3, le=360)] = 36
    inner_radius_mm: Length = 1.0
    outer_radius_mm: Length = 12.0
    height_mm: Length = 0.2
    rim_mm: Length = 3.0
    base_mm: Length = 3.0


def build_siemens_star(parameters: SiemensStarParameters, name: str, where: str) -> Artefact:
    """Build a star.

    Parameters
    ----------
    parameters : SiemensStarParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the feature ``reference``, the rim beside the star on the +x side.  Certified are the
        spokes' height and both radii.

    Raises
    ------
    InputError
        If the outer radius is not larger than the inner one.
    """
    p = parameters
    if p.outer_radius_mm < 1.05 * p.inner_radius_mm:
        expected = f"at least {1.05 * p.inner_radius_mm:.6g}, beyond the inner radius"
        raise InputError(f"{where}.outer_radius_mm", expected, p.outer_radius_mm)
    half = p.outer_radius_mm + p.rim_mm
    plate = manifold3d.Manifold.cube((2.0 * half, 2.0 * half, p.base_mm))
    solid = plate.translate((-half, -half, -p.base_mm)).as_original()
    owners = {solid.original_id(): "plate"}
    width = np.pi / p.spokes
    chords = max(2, int(np.ceil(width / _CHORD)))
    arc = np.linspace(-0.5 * width, 0.5 * width, chords + 1)
    spokes = []
    for k in range(p.spokes):
        angle = arc + 2.0 * np.pi * k / p.spokes
        outline = np.concatenate(
            [
                p.outer_radius_mm * np.column_stack((np.cos(angle), np.sin(angle))),
                p.inner_radius_mm * np.column_stack((np.cos(angle), np.sin(angle)))[::-1],
            ]
        )
        section = manifold3d.CrossSection([outline])
        # Sunk into the plate, so that no face lies on another.
        sunk = 0.5 * p.base_mm
        spokes.append(section.extrude(p.height_mm + sunk).translate((0.0, 0.0, -sunk)))
    star = manifold3d.Manifold.batch_boolean(spokes, manifold3d.OpType.Add).as_original()
    owners[star.original_id()] = "spokes"
    mesh, parts = to_mesh(solid + star, owners)
    margin = _MARGIN * p.rim_mm
    rim = PlaneFeature(
        name=REFERENCE,
        height_mm=0.0,
        z_mm=0.0,
        x_mm=(p.outer_radius_mm + margin, half - margin),
        y_mm=(-half + margin, half - margin),
    )
    return Artefact(
        name=name,
        kind="siemens_star",
        parameters=p.model_dump(),
        mesh=mesh,
        parts=parts,
        certified={
            "spoke_height_mm": p.height_mm,
            "inner_radius_mm": p.inner_radius_mm,
            "outer_radius_mm": p.outer_radius_mm,
        },
        features=(rim,),
    )


def measure_siemens_star(artefact: Artefact) -> dict[str, float]:
    """Measure a star from the faces of the part ``spokes``.

    Parameters
    ----------
    artefact : Artefact
        A star.

    Returns
    -------
    dict of str to float
        ``spoke_height_mm`` above the plate, ``inner_radius_mm`` and ``outer_radius_mm``.
    """
    mesh = artefact.mesh
    corners = mesh.vertices[np.unique(mesh.faces[artefact.parts["spokes"]])]
    top = float(corners[:, 2].max())
    radius = np.hypot(*corners[corners[:, 2] == top, :2].T)
    plate = mesh.vertices[np.unique(mesh.faces[artefact.parts["plate"]])]
    # The plate's own face is the highest that it has between the spokes.
    level = float(plate[np.abs(plate[:, :2]).max(axis=1) == np.abs(plate[:, :2]).max(), 2].max())
    return {
        "spoke_height_mm": top - level,
        "inner_radius_mm": float(radius.min()),
        "outer_radius_mm": float(radius.max()),
    }


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(SiemensStarParameters, build_siemens_star, measure_siemens_star)
