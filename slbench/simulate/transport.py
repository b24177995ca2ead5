"""Light transport: what a camera pixel sees of the projector's panel, as a sparse matrix.

Light is linear: for a fixed scene the radiance image is ``I = T p + A`` with the panel ``p``
(values in [0, 1]), the light transport matrix ``T`` (camera pixels x panel pixels) and the
ambient image ``A``.  Fringes vary along one panel axis only, so ``T`` is kept summed over the
other one (a *marginal*): ``"u"`` has one column per panel column, ``"v"`` one per panel row,
``"uv"`` one per panel pixel (row-major).

Tracing happens in :mod:`slbench.simulate.render`; this module stores, multiplies and saves, and
works on a machine without Mitsuba.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.io import read_npz, write_npz
from slbench.core.show.display import block
from slbench.core.threads import in_bands
from slbench.rig.optics.spread import Spread
from slbench.simulate.footprints import BlurredPanel, Levels
from slbench.simulate.packing import summed
from slbench.simulate.rows import SparseRows, row_starts

if TYPE_CHECKING:
    import scipy.sparse

    from slbench.simulate.torch_light import TorchLight

Marginal = Literal["u", "v", "uv"]

#: Pixels handled together in the product: their panel entries and sums stay in the cache.
_TILE = 64
#: Pixels that are worth a thread.
_LEAST = 1 << 12
#: Up to so many columns are sorted by insertion alone.
_INSERTED = 32
#: Of a panel image's pixel on its way through the product: values, radiance, two copies.
_PANEL_BYTES = 24
#: Entries that 32 bits count.
_MOST_INT32 = np.iinfo(np.int32).max
#: Version of the file layout; in the first, all columns are panel pixels, and columns and weights
#: are stored as they are.
_FORMAT = 2
#: That of a file of three bands (:mod:`slbench.simulate.colour`).
COLOUR = 3
#: Bytes of a weight, each stored as an array: exponents deflate well, the last bits do not.
_BYTES = tuple(f"data{k}" for k in range(4))
#: What a file may hold of use.
ENTRIES = (
    *("format", "panel", "samples", "ambient"),
    *(
        f"{name}_{part}"
        for name in ("u", "v", "uv")
        for part in ("counts", "indices", "data", "steps", *_BYTES)
    ),
    *(f"{name}_{part}" for name in ("u", "v") for part in ("spread", "levels")),
)


@njit(cache=True, nogil=True)
def _product(indptr, indices, data, panels, ambient, least, out, start, stop):  # type: ignore[no-untyped-def]
    """out[k, p] = ambient[p] + sum_j T[p, j] panels[j, k], tile by tile, pixels start to stop.

    Sums below `least` are set to it.
    """
    n = out.shape[0]
    if n == 1:
        for p in range(start, stop):
            one = np.float32(0)
            for j in range(indptr[p], indptr[p + 1]):
                one += data[j] * panels[indices[j], 0]
            out[0, p] = ambient[p] + max(one, least)
        return
    sums = np.empty((_TILE, n), np.float32)
    for first in range(start, stop, _TILE):
        last = min(first + _TILE, stop)
        for p in range(first, last):
            for k in range(n):
                sums[p - first, k] = np.float32(0)
            for j in range(indptr[p], indptr[p + 1]):
                weight, column = data[j], indices[j]
                for k in range(n):
                    sums[p - first, k] += weight * panels[column, k]
        for k in range(n):
            for p in range(first, last):
                out[k, p] = ambient[p] + max(sums[p - first, k], least)


@dataclass(frozen=True)
class LightTransport:
    """Light transport from a projector's panel to a camera's pixels.

    Parameters
    ----------
    marginals : mapping of "u", "v", "uv" to SparseRows
        One row per camera pixel, row-major; at least one.
    ambient : (V, U) float32
        Radiance with the panel dark, W / (mm^2 sr).
    panel : (int, int)
        Width and height of the panel, px.
    samples : int
        Monte Carlo samples per pixel it was traced with.
    """

    marginals: Mapping[Marginal, SparseRows]
    ambient: NDArray[np.float32]
    panel: tuple[int, int]
    samples: int

    def __repr__(self) -> str:
        (rows, columns), (width, height) = self.shape, self.panel
        entries = (f"{name}: {one.indices.size} entries" for name, one in self.marginals.items())
        return block(
            f"LightTransport from a panel of {width} x {height} px to {columns} x {rows} px",
            f"{', '.join(entries)}; {self.samples} samples a pixel",
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Camera image shape (V, U)."""
        return self.ambient.shape[0], self.ambient.shape[1]

    def _rows(self, marginal: Marginal) -> SparseRows:
        if marginal not in self.marginals:
            raise InputError(
                "light transport", f"the {marginal!r} marginal", " and ".join(self.marginals)
            )
        return self.marginals[marginal]

    def _size(self, marginal: Marginal) -> int:
        """Return the number of panel pixels that a marginal tells apart."""
        width, height = self.panel
        return {"u": width, "v": height, "uv": width * height}[marginal]

    def relight(self, panels: ArrayLike, along: Marginal = "u") -> NDArray[np.float32]:
        """Return radiance images under patterns that vary along one panel axis, or both.

        Parameters
        ----------
        panels : (n, W), (n, H) or (n, H, W) float
            Panel radiance per column ("u"), row ("v") or pixel ("uv"), in [0, 1].
        along : {"u", "v", "uv"}

        Returns
        -------
        (n, V, U) float32
            W / (mm^2 sr).
        """
        return self.relight_images(panels) if along == "uv" else self._relight(panels, along)

    def relight_images(self, images: ArrayLike) -> NDArray[np.float32]:
        """Return radiance images (n, V, U) under any panel images (n, H, W); needs "uv"."""
        stack = np.asarray(images)
        if stack.ndim != 3 or stack.shape[1:] != (self.panel[1], self.panel[0]):
            raise InputError(
                "panel images", f"shape (n, {self.panel[1]}, {self.panel[0]})", stack.shape
            )
        return self._relight(stack.reshape(len(stack), -1), "uv")

    def _relight(self, panels: ArrayLike, marginal: Marginal) -> NDArray[np.float32]:
        rows = self._rows(marginal)
        try:
            values = np.asarray(panels, dtype=np.float32)
        except (TypeError, ValueError):
            raise InputError("panel profiles", "numbers", type(panels).__name__) from None
        if values.ndim != 2 or values.shape[1] != self._size(marginal):
            raise InputError("panel profiles", f"shape (n, {self._size(marginal)})", values.shape)
        if not np.all(np.isfinite(values)):
            raise InputError("panel profiles", "finite numbers", "others")
        out = np.empty((len(values), self.ambient.size), np.float32)
        # Panel-major, so that one transport entry serves all patterns in one vector operation.
        panel_major = np.ascontiguousarray(values.T)
        ambient = self.ambient.reshape(-1)
        seen = panel_major if rows.blurred is None else rows.blurred.blur(panel_major)
        # Interpolation between nodes may undershoot where a panel is dark; light does not.
        given = (rows.indptr, rows.indices, rows.data, seen, ambient, np.float32(0.0), out)
        in_bands(lambda first, last: _product(*given, first, last), ambient.size, _LEAST)
        return out.reshape(len(values), *self.shape)

    def white(self) -> NDArray[np.float32]:
        """Return the radiance image of the fully lit panel, (V, U)."""
        marginal: Marginal = next(iter(self.marginals))
        return self._relight(np.ones((1, self._size(marginal))), marginal)[0]

    def whites(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Return what each channel sees of the fully lit and the dark panel: the only one."""
        return [(self.white(), self.ambient)]

    def view_from_projector(self, camera_image: ArrayLike) -> NDArray[np.float64]:
        """Return ``T^T`` times a camera image: dual photography, needs "uv".

        The scene as the projector would see it, lit by a projector at the camera that shows
        `camera_image` (Sen et al., "Dual photography", SIGGRAPH 2005).

        Parameters
        ----------
        camera_image : (V, U) float

        Returns
        -------
        (H, W) float
        """
        image = np.asarray(camera_image, dtype=np.float64)
        if image.shape != self.shape:
            raise InputError("camera image", f"shape {self.shape}", image.shape)
        seen = self._rows("uv").tocsr().T @ image.ravel()
        return seen.reshape(self.panel[1], self.panel[0])

    def to_scipy(self, along: Marginal = "u") -> scipy.sparse.csr_array:
        """Return a marginal as one SciPy sparse array, such as NumPy and JAX users multiply by.

        Radiance is ``to_scipy("u") @ panel + ambient.ravel()`` for a panel profile (W,).  Where a
        row has light of a footprint it has an entry for each panel pixel of it; :meth:`factors` has
        fewer.

        Returns
        -------
        (V U, W), (V U, H) or (V U, H W) csr_array of float32
            Rows and panel pixels are row-major.

        Raises
        ------
        InputError
            If the light has no such marginal.
        """
        return self._rows(along).tocsr()

    def factors(self, along: Marginal = "u") -> tuple[scipy.sparse.csr_array, ...]:
        """Return SciPy sparse arrays whose product is a marginal: ``(S, B)``, or itself alone.

        ``B`` blurs the panel, ``S`` looks it up (:mod:`slbench.simulate.footprints`).
        """
        rows = self._rows(along)
        seen = replace(rows, blurred=None).tocsr()
        return (seen,) if rows.blurred is None else (seen, rows.blurred.matrix())

    def torch(
        self,
        along: Marginal = "u",
        *,
        pixels: ArrayLike | None = None,
        dense: bool = False,
        dtype: Any = None,
        device: Any = None,
    ) -> TorchLight:
        """Return a marginal as a PyTorch module, ``radiance = light(panel)``; extra ``torch``.

        It has gradients for the panel, and equals :meth:`relight` to float rounding.

        Parameters
        ----------
        along : {"u", "v", "uv"}
        pixels : (P,) int, optional
            Flat indices of camera pixels; all by default.
        dense : bool
            Keep the whole matrix and not only its entries: for few pixels.
        dtype : torch.float32 or torch.float64, optional
            Single precision by default.
        device : torch.device or str, optional

        Returns
        -------
        TorchLight
            Takes a tensor (K, W), (K, H) or (K, H, W), and gives (K, V, U), or (K, P).

        Raises
        ------
        InputError
            If PyTorch is not installed, the light has no such marginal, or no such pixels.
        """
        from slbench.simulate.torch_light import TorchLight

        width, height = self.panel
        shapes = {"u": (width,), "v": (height,), "uv": (height, width)}
        how = {"pixels": pixels, "dense": dense, "dtype": dtype, "device": device}
        return TorchLight(self.factors(along), self.ambient, shapes[along], **how)

    def half(self) -> LightTransport | None:
        """Return the transport by one half of the samples; None where that was not kept.

        What comes of it differs from what comes of all samples by one draw of the Monte Carlo
        error of all: half the difference of two independent halves has the variance of their mean.
        """
        if any(rows.differences is None for rows in self.marginals.values()):
            return None
        return replace(self, marginals={name: rows.half() for name, rows in self.marginals.items()})

    def band(self, rows: slice) -> LightTransport:
        """Return the transport to the image rows `rows` (without step)."""
        first, last, _ = rows.indices(self.shape[0])
        width = self.shape[1]
        marginals = {
            name: block.band(first * width, last * width) for name, block in self.marginals.items()
        }
        return LightTransport(marginals, self.ambient[first:last], self.panel, self.samples)

    def chosen(self, pixels: NDArray[np.intp]) -> LightTransport:
        """Return the transport to some pixels (P,), flat indices, as an image of one row."""
        marginals = {name: rows.chosen(pixels) for name, rows in self.marginals.items()}
        ambient = self.ambient.reshape(1, -1)[:, pixels]
        return LightTransport(marginals, ambient, self.panel, self.samples)

    def batches(
        self, n_frames: int, budget_bytes: int = 1 << 28, along: Marginal = "u"
    ) -> Iterator[slice]:
        """Split `n_frames` that vary along `along` so that a batch stays within `budget_bytes`.

        What counts is the float32 images, or the panel images behind them in double and single
        precision, which are no larger than a row or column otherwise.
        """
        shown = _PANEL_BYTES * self.panel[0] * self.panel[1] if along == "uv" else 0
        step = max(1, budget_bytes // max(4 * self.ambient.size, shown))
        for first in range(0, n_frames, step):
            yield slice(first, min(first + step, n_frames))

    @classmethod
    def from_entries(
        cls,
        rows: ArrayLike,
        columns: ArrayLike,
        values: ArrayLike,
        shape: tuple[int, int],
        panel: tuple[int, int],
        ambient: ArrayLike | None = None,
    ) -> LightTransport:
        """Return light transport from the entries of its full matrix, another program's for one.

        Parameters
        ----------
        rows, columns : (n,) int
            Camera pixel ``v * U + u`` and panel pixel ``v * W + u`` of each entry, in any order;
            of entries at one place the sum counts.
        values : (n,) float
            Radiance under that panel pixel at 1.
        shape : (int, int)
            Of the camera's image, (V, U).
        panel : (int, int)
            Width and height of the panel, px.
        ambient : (V, U) float, optional
            Radiance with the panel dark; none by default.

        Returns
        -------
        LightTransport
            With ``"u"``, ``"v"`` and ``"uv"``; its number of samples is 0, as not known.

        Raises
        ------
        InputError
            If entries do not fit the image and the panel, or values are not finite.
        """
        import scipy.sparse  # a scan does without

        (height, width), (panel_width, panel_height) = shape, panel
        places = [np.asarray(rows), np.asarray(columns)]
        weights = np.asarray(values, dtype=np.float64)
        sizes = (height * width, panel_width * panel_height)
        if any(one.shape != weights.shape or one.ndim != 1 for one in places):
            got = ", ".join(str(one.shape) for one in (*places, weights))
            raise InputError("light transport entries", "three arrays of one length", got)
        for name, one, size in zip(("rows", "columns"), places, sizes, strict=True):
            if one.size and not (one.dtype.kind in "iu" and 0 <= one.min() <= one.max() < size):
                got = f"{one.min()} to {one.max()}, {one.dtype}"
                raise InputError(f"light transport {name}", f"pixels from 0 to {size - 1}", got)
        if not np.all(np.isfinite(weights)):
            raise InputError("light transport values", "finite numbers", "others")
        dark = np.zeros(shape) if ambient is None else np.asarray(ambient)
        if dark.shape != tuple(shape):
            raise InputError("ambient", f"shape {tuple(shape)}", dark.shape)
        columns_of: dict[Marginal, tuple[NDArray[Any], int]] = {
            "u": (places[1] % panel_width, panel_width),
            "v": (places[1] // panel_width, panel_height),
            "uv": (places[1], sizes[1]),
        }
        marginals: dict[Marginal, SparseRows] = {}
        for along, (where, count) in columns_of.items():
            entries = (weights, (places[0].astype(np.int64), where.astype(np.int64)))
            matrix = scipy.sparse.coo_array(entries, shape=(sizes[0], count)).tocsr()
            matrix.sort_indices()
            marginals[along] = SparseRows(
                row_starts(np.diff(matrix.indptr)),
                matrix.indices.astype(np.uint16 if count <= 1 << 16 else np.uint32),
                matrix.data.astype(np.float32),
                count,
            )
        return cls(marginals, dark.astype(np.float32), (panel_width, panel_height), 0)

    def save(self, path: str | Path) -> None:
        """Write as ``.npz`` without pickles."""
        write_npz(path, **self.arrays())

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what is written, by the names of the entries."""
        arrays: dict[str, np.ndarray] = {
            "format": np.array(_FORMAT),
            "panel": np.array(self.panel),
            "samples": np.array(self.samples),
            "ambient": self.ambient,
        }
        for name, rows in self.marginals.items():
            # Row lengths are small numbers: a byte or two each, where row starts take eight.
            counts = np.diff(rows.indptr)
            arrays[f"{name}_counts"] = counts.astype(np.min_scalar_type(counts.max(initial=0)))
            # Columns of a row are neighbours: steps are small, and wrap around where a row begins.
            arrays[f"{name}_steps"] = np.diff(rows.indices, prepend=rows.indices.dtype.type(0))
            planes = rows.data.astype("<f4", copy=False).view(np.uint8).reshape(-1, 4).T
            arrays |= {f"{name}_{part}": plane for part, plane in zip(_BYTES, planes, strict=True)}
            if rows.blurred is not None:
                spread = rows.blurred.levels.spread
                arrays[f"{name}_spread"] = np.array([spread.diffraction_px, spread.blur_px])
                parts = (rows.blurred.used, rows.blurred.first, rows.blurred.nodes)
                arrays[f"{name}_levels"] = np.array(parts, np.uint32)
        return arrays

    @classmethod
    def load(cls, path: str | Path, content: bytes | None = None) -> LightTransport:
        """Read what :meth:`save` wrote.

        Parameters
        ----------
        path : str or Path
        content : bytes, optional
            Of the file, which then need not exist: its path is for messages.

        Raises
        ------
        InputError
            If the file is missing, corrupt, or inconsistent.
        """
        return cls.of_arrays(read_npz(path, ENTRIES, content), path)

    @classmethod
    def of_arrays(cls, arrays: dict[str, NDArray[Any]], path: str | Path) -> LightTransport:
        """Return what :meth:`arrays` gave; `path` is named in messages.

        Raises
        ------
        InputError
            As :meth:`load`.
        """
        version = _checked(path, arrays, "format", "iu", 0)
        if int(version) not in (1, _FORMAT):
            colour = " (3 is in colour: ColourTransport.load)" if int(version) == COLOUR else ""
            raise InputError(f"{path}: format", f"1 or {_FORMAT}{colour}", version)
        samples = int(_checked(path, arrays, "samples", "iu", 0))
        ambient = _checked(path, arrays, "ambient", "f", 2).astype(np.float32, copy=False)
        panel = _checked(path, arrays, "panel", "iu", 1)
        if panel.shape != (2,) or panel.min() < 1:
            raise InputError(f"{path}: panel", "a width and a height", panel)
        width, height = (int(n) for n in panel)
        columns: dict[Marginal, int] = {"u": width, "v": height, "uv": width * height}
        marginals: dict[Marginal, SparseRows] = {}
        for name, size in columns.items():
            if f"{name}_counts" not in arrays:
                continue
            counts = _checked(path, arrays, f"{name}_counts", "u", 1)
            indices, data = _entries(path, arrays, name, int(version))
            if int(counts.max(initial=0)) > indices.size:  # before sums of them can overflow
                raise InputError(f"{path}: {name}", "a consistent sparse matrix", "a damaged one")
            indptr = row_starts(counts)
            blurred = None
            if f"{name}_levels" in arrays:
                blurred = _blurred(path, arrays, name, size)
                size = blurred.width
            consistent = (
                indptr.size == ambient.size + 1
                and indices.size == data.size == indptr[-1]
                and (indices.size == 0 or int(indices.max()) < size)
            )
            if not consistent:
                raise InputError(f"{path}: {name}", "a consistent sparse matrix", "a damaged one")
            marginals[name] = SparseRows(
                indptr, indices, data.astype(np.float32, copy=False), size, blurred
            )
        if not marginals:
            raise InputError(path, "at least one of the marginals u, v, uv", "none")
        return LightTransport(marginals, ambient, (width, height), samples)


def _checked(
    path: str | Path,
    arrays: dict[str, NDArray[Any]],
    key: str,
    kinds: str,
    dimensions: int,
    least: float = 0.0,
) -> NDArray[Any]:
    """Return an array of a file if it is there, of the right kind, finite and not too small."""
    if key not in arrays:
        raise InputError(f"{path}: {key}", "a light transport file", "no such entry")
    array = arrays[key]
    if array.dtype.kind not in kinds or array.ndim != dimensions:
        found = f"{array.dtype} of shape {array.shape}"
        raise InputError(f"{path}: {key}", f"{dimensions}-dimensional numbers", found)
    if array.size and not (array.dtype.kind == "u" and least <= 0.0):
        smallest, largest = array.min(), array.max()
        if not (smallest >= least and -np.inf < smallest <= largest < np.inf):
            which = " that are not negative" if least == 0.0 else ""
            raise InputError(f"{path}: {key}", f"finite numbers{which}", "others")
    return array


def _entries(
    path: str | Path, arrays: dict[str, NDArray[Any]], name: str, version: int
) -> tuple[NDArray[np.unsignedinteger], NDArray[np.floating]]:
    """Return columns and weights of a marginal."""
    if version == 1:
        indices = _checked(path, arrays, f"{name}_indices", "u", 1)
    else:
        steps = _checked(path, arrays, f"{name}_steps", "u", 1)
        indices = summed(steps, np.empty_like(steps))
        planes = [_checked(path, arrays, f"{name}_{part}", "u", 1) for part in _BYTES]
        if any(plane.dtype != np.uint8 or plane.shape != indices.shape for plane in planes):
            raise InputError(f"{path}: {name}", "four bytes a weight", "others")
        joined = cv2.merge(planes) if indices.size else np.empty((0, 4), np.uint8)
        arrays = {f"{name}_data": joined.reshape(-1).view("<f4")}
    return indices, _checked(path, arrays, f"{name}_data", "f", 1, least=-np.inf)


def _blurred(
    path: str | Path, arrays: dict[str, NDArray[Any]], name: str, size: int
) -> BlurredPanel:
    """Return what the columns of a marginal stand for."""
    spread = _checked(path, arrays, f"{name}_spread", "f", 1)
    parts = _checked(path, arrays, f"{name}_levels", "u", 2).astype(np.int64)
    if spread.shape != (2,) or spread.max() > 1e4 or len(parts) != 3 or parts.max(initial=0) > 1e5:
        raise InputError(f"{path}: {name}_levels", "levels of a spread", "others")
    used, first, nodes = parts
    levels = Levels(Spread(*spread.tolist()), size)
    whole = levels.grids(int(used.max(initial=0)) + 1).nodes[used]
    if np.any(np.diff(used) < 1) or np.any(first + nodes > whole):
        raise InputError(f"{path}: {name}_levels", "ascending levels and their nodes", "others")
    return BlurredPanel(levels, used, first, nodes)
