"""A step block: ascending flat faces of certified height above a reference face.

The thesis measures two metric step blocks to ASTM E797, with heights of 1.0, 2.5, 5.0 mm
(thesis table 6) and 2.5, 5, 10, 15, 20 mm (thesis table 7).
Real blocks have their edges broken: the upper edge of every rise can have a chamfer.

Object frame: x along the stairs, the origin at the middle of the block in x and y, and
z = 0 on the reference face, which is the first and lowest one (at the -x end).  The faces
follow in ascending order towards +x; the bottom of the base is at z = -base_mm.
"""

import itertools
from typing import Annotated

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length, MaxLen, MinLen, NotNegative
from slbench.objects.artefact import REFERENCE, Artefact, PlaneFeature
from slbench.objects.mesh.solids import prism
from slbench.objects.registry import ArtefactKind


class StepBlockParameters(Parameters):
    """Size of a step block.

    Parameters
    ----------
    heights_mm : tuple of float
        Heights above the reference face, ascending; one face each.
    step_length_mm : float
        Extent of every face along x, the reference face's too.
    width_mm : float
        Extent along y.
    base_mm : float
        Thickness below the reference face.
    margin_fraction : float
        Distance from a face's edges to its interior, as a share of the step length: a
        camera pixel on an edge sees two faces, and the upper one shadows the lower.
    chamfer_mm : float
        Legs of the 45 degree chamfer on the upper edge of every rise; 0 for sharp edges.
    """

    heights_mm: Annotated[tuple[Length, ...], MinLen(1), MaxLen(50)]
    step_length_mm: Length
    width_mm: Length
    base_mm: Length = 5.0
    margin_fraction: Annotated[float, Interval(ge=0.0, le=0.45)] = 0.15
    chamfer_mm: NotNegative = 0.0


def build_step_block(parameters: StepBlockParameters, name: str, where: str) -> Artefact:
    """Build a step block.

    Parameters
    ----------
    parameters : StepBlockParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the features ``reference``, ``step_1``, ``step_2``, ...; certified are the
        heights of the steps.

    Raises
    ------
    InputError
        If the heights do not ascend by a micrometre or more, the block is too narrow for
        the margins, or the chamfer reaches into an interior or leaves no wall below it.
    """
    heights = (0.0, *parameters.heights_mm)
    rises = [upper - lower for lower, upper in itertools.pairwise(heights)]
    if min(rises) < 1e-3 - 1e-9:  # 1.001 - 1 rounds to less than 0.001
        expected = "heights that ascend by at least 0.001"
        raise InputError(f"{where}.heights_mm", expected, list(parameters.heights_mm))
    step, width = parameters.step_length_mm, parameters.width_mm
    margin = parameters.margin_fraction * step
    if width <= 2.0 * margin:
        expected = f"more than two margins of {margin:g} mm (margin_fraction x step_length_mm)"
        raise InputError(f"{where}.width_mm", expected, width)
    chamfer = parameters.chamfer_mm
    largest = min(margin, min(rises) - 1e-3)
    if chamfer and not 1e-3 <= chamfer <= largest * (1.0 + 1e-12):
        expected = f"0, or from 0.001 to {largest:.6g} (the margin; less than the smallest rise)"
        raise InputError(f"{where}.chamfer_mm", expected, chamfer)

    edges = [(i - len(heights) / 2) * step for i in range(len(heights) + 1)]
    profile = [(edges[0], -parameters.base_mm), (edges[-1], -parameters.base_mm)]
    for i in reversed(range(len(heights))):
        profile.append((edges[i + 1], heights[i]))
        if i > 0 and chamfer > 0.0:
            profile.append((edges[i] + chamfer, heights[i]))
            profile.append((edges[i], heights[i] - chamfer))
        else:
            profile.append((edges[i], heights[i]))
    features = tuple(
        PlaneFeature(
            name=REFERENCE if i == 0 else f"step_{i}",
            height_mm=height,
            z_mm=height,
            x_mm=(edges[i] + margin, edges[i + 1] - margin),
            y_mm=(-width / 2 + margin, width / 2 - margin),
        )
        for i, height in enumerate(heights)
    )
    return Artefact(
        name=name,
        kind="step_block",
        parameters=parameters.model_dump(),
        mesh=prism(profile, width),
        certified={f"{face.name}_height_mm": face.height_mm for face in features[1:]},
        features=features,
    )


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(StepBlockParameters, build_step_block)
