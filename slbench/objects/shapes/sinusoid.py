"""A sinusoidal surface, for transfer functions: what amplitude of a known one is measured.

The surface is ``z = a sin(2 pi x / p)`` over a whole number of periods, piecewise linear
between equally spaced points on x.  Linear interpolation takes ``sinc(1 / n)^2`` of the
amplitude, n points a period, so the points are raised by its inverse: *the fundamental of
the mesh has the certified amplitude*, and what its flats deviate from the sine is in the
harmonics n - 1, n + 1 and above, (pi / n)^2 / 2 of the amplitude in all.

Object frame: x across the waves, origin at the middle; z = 0 is the mean height.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import Artefact
from slbench.objects.mesh.heightfield import height_field
from slbench.objects.registry import ArtefactKind
from slbench.objects.targets.common import Micrometres


class SinusoidParameters(Parameters):
    """Size of a sinusoidal surface.

    Parameters
    ----------
    amplitude_um : float
        Half of what lies between crests and troughs.
    period_um : float
        Length of a wave.
    periods : int
        Waves along x.
    width_mm : float
        Extent along y.
    thickness_mm : float
        From the bottom to the mean height; more than the amplitude.
    points_per_period : int
        Points of the mesh along a wave; a multiple of 4.
    """

    amplitude_um: Micrometres
    period_um: Micrometres
    periods: Annotated[int, Interval(ge=1, le=1000)] = 10
    width_mm: Length = 1.0
    thickness_mm: Length = 0.5
    points_per_period: Annotated[int, Field(ge=16, le=1024, multiple_of=4)] = 128


def build_sinusoid(parameters: SinusoidParameters, name: str, where: str) -> Artefact:
    """Build a sinusoidal surface.

    Parameters
    ----------
    parameters : SinusoidParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        Without features: the certified surface is not flat.  Certified are amplitude and
        period, and the size along x and y.

    Raises
    ------
    InputError
        If the troughs reach the bottom.
    """
    amplitude, period = 1e-3 * parameters.amplitude_um, 1e-3 * parameters.period_um
    points = parameters.points_per_period
    peak = amplitude / np.sinc(1.0 / points) ** 2
    if parameters.thickness_mm < peak + 1e-3:
        expected = f"at least {peak + 1e-3:.6g}, for the troughs to stay above the bottom"
        raise InputError(f"{where}.thickness_mm", expected, parameters.thickness_mm)
    step = np.arange(parameters.periods * points + 1) - parameters.periods * points / 2
    # One wave, repeated: every period has the same heights to the last bit.
    z = peak * np.sin(2.0 * np.pi * (step % points) / points)
    half = 0.5 * parameters.width_mm
    return Artefact(
        name=name,
        kind="sinusoid",
        parameters=parameters.model_dump(),
        mesh=height_field(
            step * (period / points), [-half, half], np.stack([z, z]), -parameters.thickness_mm
        ),
        certified={
            "size_x_mm": parameters.periods * period,
            "size_y_mm": parameters.width_mm,
            "amplitude_um": parameters.amplitude_um,
            "period_um": parameters.period_um,
        },
    )


def measure_sinusoid(artefact: Artefact) -> dict[str, float]:
    """Measure amplitude and period from the profile of the mesh.

    Parameters
    ----------
    artefact : Artefact
        A sinusoidal surface.

    Returns
    -------
    dict of str to float
        ``period_um``, the mean distance of the places where the profile rises through its
        mean, or of its ends if there are fewer than two; ``amplitude_um``, that of the
        fundamental of the piecewise linear profile.
    """
    vertices = artefact.mesh.vertices
    bottom, side = vertices[:, 2].min(), vertices[:, 1].max()
    profile = vertices[(vertices[:, 1] == side) & (vertices[:, 2] > bottom)]
    x, z = profile[np.argsort(profile[:, 0])][:, [0, 2]].T
    length = x[-1] - x[0]
    z = z - np.trapezoid(z, x) / length
    # Just below zero, so that a point on the mean line up to rounding counts once.
    level = -1e-3 * np.abs(z).max()
    rising = np.flatnonzero((z[:-1] < level) & (z[1:] >= level))
    crossings = x[rising] + (level - z[rising]) / np.diff(z)[rising] * np.diff(x)[rising]
    period = np.diff(crossings).mean() if len(crossings) > 1 else length
    # Gauss's rule of 4 points integrates a wave over a 16th of it to 1e-14.
    nodes, weights = np.polynomial.legendre.leggauss(4)
    share = 0.5 * (1.0 + nodes)
    places = x[:-1, None] + share * np.diff(x)[:, None]
    heights = z[:-1, None] + share * np.diff(z)[:, None]
    wave = heights * np.exp(-2j * np.pi * places / period)
    fundamental = np.einsum("ij,j,i->", wave, weights, np.diff(x)) / length
    return {"period_um": 1e3 * float(period), "amplitude_um": 1e3 * float(abs(fundamental))}


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(SinusoidParameters, build_sinusoid, measure_sinusoid)
