"""A closed surface put together from loops of points: the walls between them, and flat rings.

For solids whose outline no boolean operation should touch: vertices are the points given, bit
for bit, and equal input gives equal vertices and faces in equal order.  Only the insides of
flat rings are triangulated (manifold3d, which adds no points).
"""

import manifold3d
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.objects.artefact import Mesh

#: Vertex numbers of a closed loop, counter-clockwise seen from +z.
Loop = NDArray[np.int64]


class Shell:
    """A surface under construction; :meth:`mesh` gives the result.

    Walking once around the solid's cross-section, up its outside and down its inside, names
    the loops of :meth:`wall` and :meth:`ring` in the order that makes all faces look outwards.
    """

    def __init__(self) -> None:
        self._vertices: list[NDArray[np.float64]] = []
        self._faces: list[NDArray[np.int64]] = []
        self._count = 0

    def vertices(self, points_mm: ArrayLike) -> NDArray[np.int64]:
        """Add points, (n, 3), and return their numbers, (n,)."""
        points = np.asarray(points_mm, dtype=np.float64)
        self._vertices.append(points)
        self._count += len(points)
        return np.arange(self._count - len(points), self._count)

    def loop(self, outline_mm: NDArray[np.float64], z_mm: ArrayLike) -> Loop:
        """Add a loop at a height.

        Parameters
        ----------
        outline_mm : (n, 2) ndarray of float
            Its points, counter-clockwise seen from +z.
        z_mm : float or (n,) array_like
            Their height.

        Returns
        -------
        (n,) ndarray of int
            The numbers of its vertices.
        """
        heights = np.broadcast_to(np.asarray(z_mm, dtype=np.float64), len(outline_mm))
        return self.vertices(np.column_stack([outline_mm, heights]))

    def wall(self, first: Loop, second: Loop, *, mirrored: bool = False) -> None:
        """Join two loops of as many points by a band of triangles.

        Parameters
        ----------
        first, second : Loop
            The band looks away from the axis where the second is the upper one, and towards
            the axis where it is the lower one.
        mirrored : bool
            Whether each four-sided patch is cut along its other diagonal.
        """
        a, b = first, second
        next_a, next_b = np.roll(a, -1), np.roll(b, -1)
        if mirrored:
            corners = [a, next_a, b, next_a, next_b, b]
        else:
            corners = [a, next_a, next_b, a, next_b, b]
        self.faces(np.stack(corners, axis=1).reshape(-1, 3))

    def ring(self, outer: Loop, inner: Loop, *, up: bool) -> None:
        """Fill the flat ring between two loops of one height.

        Parameters
        ----------
        outer, inner : Loop
            Its borders.
        up : bool
            Whether it looks up or down.
        """
        points = np.concatenate(self._vertices)
        # A hole runs the other way round.
        numbers = np.concatenate([outer, inner[::-1]])
        polygons = [points[outer, :2], points[inner[::-1], :2]]
        triangles = numbers[np.asarray(manifold3d.triangulate(polygons), dtype=np.int64)]
        self.faces(triangles if up else triangles[:, ::-1])

    def height(self, loop: Loop) -> float:
        """Return the height of a loop's first point, mm."""
        return float(np.concatenate(self._vertices)[loop[0], 2])

    def faces(self, triangles: NDArray[np.int64]) -> None:
        """Add triangles, (m, 3), between vertices that are there."""
        self._faces.append(triangles)

    def mesh(self) -> Mesh:
        """Return everything added so far as a mesh."""
        return Mesh(np.concatenate(self._vertices), np.concatenate(self._faces))
