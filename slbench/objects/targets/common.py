"""What the calibration targets have in common: parameter types, cells, and measuring dots."""

from typing import Annotated

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from pydantic import Field

from slbench.core.validation.types import Interval
from slbench.objects.artefact import REFERENCE, Artefact, Mesh, PlaneFeature

#: Dots wider than this share of their cell would leave slivers between them.
WIDEST = 0.98

#: Dots, squares or corners in a row.
Count = Annotated[int, Interval(ge=2, le=200)]

#: Sides of the polygon that stands for a circle.
Segments = Annotated[int, Field(ge=128, le=1024, multiple_of=4)]

#: A length, um.
Micrometres = Annotated[float, Interval(ge=1.0, le=1e7)]

#: Width of the border left out of a fit, as a share of the size.
_MARGIN_FRACTION = 0.05


def cells(
    count: int, pitch_mm: float, border_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lay cells out along an axis, symmetric about 0, with a border cell at either end.

    Parameters
    ----------
    count : int
        Cells.
    pitch_mm : float
        Their size.
    border_mm : float
        Size of the border cells.

    Returns
    -------
    centres_mm : (count,) ndarray of float
        Middles of the cells.
    lines_mm : (count + 3,) ndarray of float
        Lines between all cells.
    """
    centres = pitch_mm * (np.arange(count, dtype=np.float64) - (count - 1) / 2)
    lines = pitch_mm * (np.arange(count + 1, dtype=np.float64) - count / 2)
    return centres, np.concatenate([[lines[0] - border_mm], lines, [lines[-1] + border_mm]])


def top_face(mesh: Mesh) -> PlaneFeature:
    """Take the reference face over all of a plate's top, less a border.

    Parameters
    ----------
    mesh : Mesh
        A plate whose top is at z = 0.

    Returns
    -------
    PlaneFeature
        The feature ``reference``.
    """
    low, high = mesh.bounds[:, :2]
    margin = _MARGIN_FRACTION * (high - low)
    (x0, y0), (x1, y1) = (low + margin).tolist(), (high - margin).tolist()
    return PlaneFeature(REFERENCE, 0.0, 0.0, (x0, x1), (y0, y1))


def discs_of(artefact: Artefact, part: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centroids and areas of the connected pieces of a flat part.

    Parameters
    ----------
    artefact : Artefact
        The artefact.
    part : str
        Which of its parts.

    Returns
    -------
    centres_mm : (n, 3) ndarray of float
        Centroid of each piece, in the order of their first faces.
    areas_mm2 : (n,) ndarray of float
        Area of each.
    """
    faces = artefact.mesh.faces[artefact.parts[part]]
    areas = artefact.mesh.face_areas[artefact.parts[part]]
    edges = faces[:, [0, 1, 1, 2]].reshape(-1, 2).T
    size = len(artefact.mesh.vertices)
    graph = scipy.sparse.coo_array((np.ones(edges.shape[1]), edges), shape=(size, size))
    vertex_pieces = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    _, pieces = np.unique(vertex_pieces[faces[:, 0]], return_inverse=True)
    middles = artefact.mesh.vertices[faces].mean(axis=1)
    totals: NDArray[np.float64] = np.bincount(pieces, areas).astype(np.float64)
    moments = [np.bincount(pieces, areas * middles[:, axis]) for axis in range(3)]
    return np.stack(moments, axis=1) / totals[:, None], totals


def spacings(centres_mm: NDArray[np.float64]) -> tuple[float, float]:
    """Mean distance along x and y between the columns and the rows that points lie in.

    Parameters
    ----------
    centres_mm : (n, 3) ndarray of float
        Points in rows along x and columns along y.

    Returns
    -------
    (float, float)
        Along x and along y, mm; NaN where all lie in one.
    """
    pitches = []
    for coordinates in np.sort(centres_mm[:, :2], axis=0).T:
        # A tenth of a nanometre apart is rounding; a micrometre apart is another row.
        steps = np.count_nonzero(np.diff(coordinates) > 1e-7)
        pitches.append(float(np.ptp(coordinates)) / steps if steps else float("nan"))
    return pitches[0], pitches[1]
