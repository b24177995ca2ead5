"""Declared features fitted to measured points, and the dimensions between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits import Fit, fit_element
from slbench.cloud.fits.geometry import ANGLE, RADIUS
from slbench.core.errors import InputError
from slbench.objects import Artefact, SurfaceFeature
from slbench.rig import Pose, Rig
from slbench.rig.pose import product
from slbench.score.dimensions import Measured, measure_dimension
from slbench.score.edges import edge_points
from slbench.score.residuals import MIN_POINTS, facing, stripes_of, trimmed_range
from slbench.score.values import (
    CircleScore,
    ConeScore,
    CylinderScore,
    FeatureScore,
    PlaneScore,
    SphereScore,
)

Array = NDArray[np.float64]

#: Walls of bores and pins stand steep to a scanner above them; beyond this a pixel's footprint is
#: four times as long as it is wide.
MAX_WALL_INCIDENCE = np.deg2rad(75.0)
#: A radius that is unsure by more than this share of it was not measured.
_UNTOLD = 0.1


@dataclass(frozen=True)
class Marked:
    """Points (N, 3) in the world and in the object's frame, with their image lines (N,).

    Without lines, `stripes` says whether errors go together along stripes of each feature.
    """

    points: Array
    local: Array
    lines: NDArray[np.integer] | None = None
    stripes: bool = False

    def of(self, chosen: NDArray[np.intp]) -> Marked:
        """Return some of them."""
        lines = None if self.lines is None else np.asarray(self.lines)[chosen]
        return Marked(self.points[chosen], self.local[chosen], lines, self.stripes)

    def labels(self, chosen: NDArray[np.intp]) -> NDArray[np.integer]:
        """Return what points of a feature are alike by: line, stripe, or each its own."""
        if self.lines is not None:
            return np.asarray(self.lines)[chosen]
        return stripes_of(self.local[chosen]) if self.stripes else np.arange(len(chosen))


def fit_surfaces(
    artefact: Artefact, inner: Marked, edges: Marked, pose: Pose, rig: Rig | None
) -> list[FeatureScore]:
    """Fit the features that an artefact's file declares, and take its dimensions.

    Parameters
    ----------
    artefact : Artefact
    inner, edges : Marked
        Points on smooth surface; those that edges are seen by.
    pose : Pose
    rig : Rig, optional

    Returns
    -------
    list of FeatureScore
        One for each feature and dimension that was measured.
    """
    needed = {name for dimension in artefact.dimensions for name in dimension.of}
    own = {surface.name for surface in artefact.declared}
    measured: dict[str, Measured] = {}
    found: list[FeatureScore] = []
    for surface in artefact.measurable:
        if surface.name not in own and surface.name not in needed:
            continue
        fitted = _measured(surface, edges if surface.kind == "circle" else inner, pose, rig)
        if fitted is not None:
            measured[surface.name] = fitted
            if surface.name in own:
                found.append(_score(artefact.name, fitted))
    for dimension in artefact.dimensions:
        if all(name in measured for name in dimension.of):
            of = [measured[name] for name in dimension.of]
            found.append(measure_dimension(artefact.name, dimension, of))
    return found


def _measured(
    surface: SurfaceFeature, marked: Marked, pose: Pose, rig: Rig | None
) -> Measured | None:
    """Return a feature with its fit, or None where too few points tell it."""
    near = surface.belonging(marked.local)
    if rig is not None and surface.kind not in ("plane", "circle"):
        normals = product(surface.normals(marked.local[near]), pose.rotation.T)
        near = near[facing(rig, marked.points[near], normals, MAX_WALL_INCIDENCE)]
    if len(near) < MIN_POINTS:
        return None
    points, lines = marked.local[near], marked.labels(near)
    spacing = 0.0
    count = len(points)
    if surface.kind == "circle":
        told = edge_points(surface, points)
        if told is None:
            return None
        points, spacing = told
        lines = np.arange(len(points))
    nominal = surface.element
    try:
        fit = fit_element(surface.kind, points, start=nominal, lines=lines, at=nominal.point)
    except InputError:  # points that no such element goes through: it was not measured
        return None
    if spacing:
        # Up to half a spacing to either side, everywhere alike or on one side of the edge.
        across = np.eye(3) - np.outer(nominal.direction, nominal.direction)
        fit.covariance[:3, :3] += across * spacing**2 / 12.0
        fit.covariance[RADIUS, RADIUS] += spacing**2 / 12.0
    if surface.kind != "plane" and not _is_told(fit):
        return None
    return Measured(surface, fit, points, count)


def _is_told(fit: Fit) -> bool:
    """Return whether the points tell the element, and not a patch that is nearly flat."""
    unsure = np.sqrt(fit.covariance[RADIUS, RADIUS])
    # NaN where too few image lines tell the uncertainty: the element itself may be good.
    return not unsure > _UNTOLD * fit.element.radius


def _score(owner: str, measured: Measured) -> FeatureScore:
    surface, fit = measured.surface, measured.fit
    nominal, element = surface.element, fit.element
    u = np.sqrt(np.diag(fit.covariance))
    form, std, count = trimmed_range(fit.residuals), fit.std_mm, measured.count
    off = element.point - nominal.point
    centre = float(np.linalg.norm(off))
    if surface.kind == "plane":
        return PlaneScore(owner, surface.name, form, std, count)
    if surface.kind == "sphere":
        return SphereScore(
            *(owner, surface.name, nominal.radius, element.radius, float(u[RADIUS])),
            *(centre, form, std, count),
        )
    diameters = (2.0 * nominal.radius, 2.0 * element.radius, 2.0 * float(u[RADIUS]))
    sizes = (owner, surface.name, *diameters)
    if surface.kind == "circle":
        return CircleScore(*sizes, centre, _circle_form(fit, measured.points), std, count)
    across = off - (off @ nominal.direction) * nominal.direction
    offset = float(np.linalg.norm(across))
    sine = float(np.linalg.norm(np.cross(element.direction, nominal.direction)))
    tilt = float(np.rad2deg(np.arcsin(min(sine, 1.0))))
    if surface.kind == "cylinder":
        return CylinderScore(*sizes, offset, tilt, form, std, count)
    opening = 2.0 * np.rad2deg([nominal.half_angle, element.half_angle, u[ANGLE]])
    wanted, got, unsure = (float(x) for x in opening)
    return ConeScore(*(owner, surface.name, wanted, got, unsure), *(offset, tilt, form, std, count))


def _circle_form(fit: Fit, points: Array) -> float:
    residual = fit.element.linearised(points)[0]
    return float(np.ptp(residual[:, 0]))
