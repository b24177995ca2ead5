"""The diagnosis of a cloud alone: distances of its points from the shape, over the shape.

Without its frames and its rig a cloud does not tell which fringes its ripples belong to: their
period is told in mm, and compared with that of the fringes where somebody states it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import nan
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slbench.bench.diagnose.accept import accepted, doubt_unit
from slbench.bench.diagnose.diagnosis import LEVEL, Diagnosis
from slbench.bench.diagnose.panel import Samples, Waves, judge, normalised, polynomial, smoothed
from slbench.bench.diagnose.regression import Group
from slbench.bench.diagnose.rim import inner
from slbench.bench.diagnose.shape import Plane, Shape, ShapeKind, Sphere, fit_shape
from slbench.bench.diagnose.waves import Wave, find_waves
from slbench.cloud.fits.squares import OUTLIER_SIGMAS
from slbench.core.errors import InputError

Array = NDArray[np.float64]

#: Step by which the shape is moved for derivatives, mm.
_STEP_MM = 1e-4
#: Points of which the distance to their neighbours is taken, and points that are judged.
_NEIGHBOURS, _MOST = 4000, 1 << 18
#: Cells, each as large as a typical distance between neighbours, that a point may stand for.
_SPARSEST = 64
#: How far, as a share, a ratio of periods may be off a whole number.
_WHOLE = 0.06
#: Share of far points within a tenth of one distance that makes them a step.
_STEP = 0.6
_ORDINALS = ("ripple", "second ripple", "third ripple")


def diagnose_cloud(
    points: Array,
    fields: Mapping[str, Array] | None = None,
    *,
    shape: ShapeKind | Literal["auto"] = "auto",
    fringe_mm: float | None = None,
    shifts: int | None = None,
    diameter_mm: float | None = None,
    where: object = "cloud",
) -> Diagnosis:
    """Say what the errors of a plane or a sphere come from, by its points alone.

    Parameters
    ----------
    points : (N, 3) float
        mm.
    fields : mapping of str to (N,) float, optional
        ``sigma``, the predicted standard deviation of a point, mm, is taken for the noise.
    shape : {"auto", "plane", "sphere"}
    fringe_mm : float, optional
        Period of the finest fringes on the object, mm, so that ripples have a cause.
    shifts : int, optional
        Frames of those fringes.
    diameter_mm : float, optional
        Of the sphere, as it is known.
    where : object
        What to call the cloud in messages.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        For fewer than 500 points, or points that are no plane and no sphere.

    Warns
    -----
    InputWarning
        For points of which a twentieth is off the shape, and a cloud in metres.
    """
    sigma = np.asarray((fields or {}).get("sigma", np.full(len(points), nan)), np.float64)
    finite = np.isfinite(points).all(axis=1)
    first = np.sort(np.unique(points[finite], axis=0, return_index=True)[1])
    points, sigma = points[finite][first], sigma[finite][first]
    if len(points) > _MOST:  # evenly: an organised cloud stays one
        step = -(-len(points) // _MOST)
        points, sigma = points[::step], sigma[::step]
    fitted = fit_shape(points, shape, where)
    doubt_unit(points, where)
    accept = accepted(fitted, points, where)
    places = _places(fitted, points)
    spacing = _spacing(places)
    rows, columns = np.ceil(np.ptp(places, axis=0) / spacing)
    if rows * columns > _SPARSEST * len(points):
        got = f"{len(points)} over {columns:.0f} x {rows:.0f} of their usual distances"
        raise InputError(where, "points that cover a surface", got)
    # Points far off stand anywhere over the shape, and are no rim.
    off = np.abs(fitted.distance(points))
    on = off <= OUTLIER_SIGMAS * 1.4826 * np.median(off)
    low = places[on].min(axis=0)
    kept = np.zeros(len(points), np.bool_)
    kept[on] = inner(np.floor((places[on] - low) / spacing).astype(np.int32))
    kept |= ~on
    points, sigma, places = points[kept], sigma[kept], places[kept]
    distance = fitted.distance(points)
    # On the shape: of the points themselves, rounding would carry their errors into the terms.
    feet = points - distance[:, None] * fitted.outward(points)
    moved = [fitted.moved(k, _STEP_MM).distance(feet) / _STEP_MM for k in range(fitted.freedom)]
    jacobian = np.stack(moved, axis=1)
    cells = np.floor((places - places.min(axis=0)) / spacing).astype(np.int32)
    nothing = np.zeros(len(points))
    samples = Samples(cells, places, distance, nothing, jacobian, nothing + 1.0, sigma)
    smooth, limit = smoothed(samples)
    rest = distance - smooth
    near = np.abs(rest) <= limit
    waves = find_waves(places[near], rest[near], spacing, LEVEL)
    names = _names(waves, fringe_mm, shifts)

    def terms(chosen: Samples) -> list[Group]:
        bowl = Group("bowl", polynomial(*normalised(chosen.places).T))
        found = zip(names, waves, strict=True)
        return [bowl, *(Group(name, wave.terms(chosen.places)) for name, wave in found)]

    result = judge(samples, terms, Waves(None, 0, nan), fitted, accept)
    told = dict(zip(names, waves, strict=True))
    causes = tuple(
        replace(cause, p=told[cause.name].p, note=_note(told[cause.name], fringe_mm))
        if cause.name in told
        else replace(cause, note=", ".join(filter(None, (cause.note, _stepped(rest[~near])))))
        if cause.name == "gross"
        else cause
        for cause in result.causes
        if cause.name != "orders"
    )
    result = replace(
        result,
        source=str(where),
        causes=causes,
        places=places,
        unit="mm",
        diameter_mm=diameter_mm,
        notes=_untold(waves, fringe_mm, sigma),
    )
    if isinstance(fitted, Sphere):
        own = fitted.diameter_deviation_mm(points[near], result["noise"].rms_mm)
        result = replace(result, diameter_deviation_mm=own)
    return result


def _places(shape: Shape, points: Array) -> Array:
    """Return where points are on the shape, (N, 2) mm: along a plane, or along great circles."""
    if isinstance(shape, Plane):
        return np.asarray((points - shape.centre) @ shape.axes.T)
    outward = shape.outward(points)
    pole = outward.mean(axis=0)
    pole /= max(float(np.linalg.norm(pole)), 1e-12)
    axes = Plane(pole, shape.centre).axes
    flat = outward @ axes.T
    sine = np.linalg.norm(flat, axis=1)
    angle = np.arctan2(sine, outward @ pole)
    return np.asarray(shape.radius * flat * (angle / np.maximum(sine, 1e-12))[:, None])


def _spacing(places: Array) -> float:
    """Return the typical distance of neighbours, mm."""
    from scipy.spatial import cKDTree

    step = max(1, len(places) // _NEIGHBOURS)
    nearest = cKDTree(places).query(places[::step], k=5)[0]
    # The mean over four neighbours: scan lines may be nearer to each other one way.
    return max(float(np.median(nearest[:, 1:].mean(axis=1))), 1e-9)


def _names(waves: list[Wave], fringe_mm: float | None, shifts: int | None) -> list[str]:
    """Return what ripples are called: by the fringes, where they are known."""
    names: list[str] = []
    for wave, usual in zip(waves, _ORDINALS, strict=False):
        name = usual
        if fringe_mm is not None:
            ratio = fringe_mm / wave.period_mm
            whole = round(ratio)
            if whole and abs(ratio - whole) <= _WHOLE * whole:
                known = {1: "unequal light", 2: "vibration"} | (
                    {shifts: "response"} if shifts else {}
                )
                name = known.get(whole, usual)
        names.append(usual if name in names else name)
    return names


def _note(wave: Wave, fringe_mm: float | None) -> str:
    angle = np.degrees(np.arctan2(wave.frequency[1], wave.frequency[0])) % 180.0
    note = f"period {wave.period_mm:.4g} mm, across {angle:.0f} deg"
    return note + (f", {fringe_mm / wave.period_mm:.3g} a fringe" if fringe_mm else "")


def _stepped(far: Array) -> str:
    """Say whether far points stand at one distance: a step."""
    if len(far) < 20:
        return ""
    usual = float(np.median(far))
    share = np.mean(np.abs(far - usual) <= 0.1 * abs(usual))
    if share < _STEP:
        return ""
    return f"a step of {usual:.3g} mm: wrong fringe orders, or another surface"


def _untold(waves: list[Wave], fringe_mm: float | None, sigma: Array) -> tuple[str, ...]:
    notes = ["a cloud alone does not tell wrong fringe orders from other points far off"]
    if waves and fringe_mm is None:
        notes.append(
            "the fringes' period on the object (--fringe-mm) by a ripple's tells its cause: "
            "1 unequal or indirect light, 2 vibration, N the response"
        )
    elif any(fringe_mm and round(fringe_mm / wave.period_mm) == 1 for wave in waves):
        notes.append("a cloud alone does not tell unequal light from indirect light")
    if not np.isfinite(sigma).any():
        notes.append("without a field `sigma` the noise is not compared with a predicted one")
    return tuple(notes)
