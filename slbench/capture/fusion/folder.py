"""Photographs as stacks: files in order of their names, pages of a TIFF, read when asked for."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.fusion.stack import Banded, Stack, banded
from slbench.core.errors import InputError
from slbench.core.io import page_count, read_colour
from slbench.core.natural import natural
from slbench.core.show.display import brief

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".exr", ".npy")
_KINDS = "PNG, TIFF, JPEG, BMP, PGM, EXR or NPY"
_LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)  # ITU-R BT.601


@dataclass(frozen=True)
class Photographs:
    """A stack of photographs on disk; index it, and the file is read.

    Attributes
    ----------
    files : tuple of (Path, int)
        The photographs: a file, and its page from 0, of a TIFF that has several.
    shape : tuple of int
        (V, U) for grey ones, (V, U, 3) for colour.
    dtype : numpy dtype
        uint8, uint16, float32 or float64.
    """

    files: tuple[tuple[Path, int], ...]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    __repr__ = brief

    @classmethod
    def open(cls, where: str | Path) -> "Photographs":
        """Find the photographs of a folder, ``f2`` ahead of ``f10``, or the pages of a TIFF.

        Of a TIFF in a folder every page is a photograph.  Files whose names begin with a dot,
        and those of other kinds, are passed over.

        Parameters
        ----------
        where : str or Path

        Raises
        ------
        InputError
            If there is nothing of that name, there are fewer than two photographs, or the first
            cannot be read.
        """
        where = Path(where)
        if where.is_dir():
            found = [
                path
                for path in where.iterdir()
                if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
            ]
            found.sort(key=lambda path: natural(path.name))
        else:
            if not where.is_file():
                raise InputError(where, "a folder of photographs", "nothing of that name")
            found = [where]
        files = [(path, page) for path in found for page in range(page_count(path))]
        if len(files) < 2:
            raise InputError(where, f"at least 2 photographs ({_KINDS})", len(files))
        path, page = files[0]
        first = read_colour(path, page=page)
        return cls(tuple(files), first.shape, first.dtype)

    def __len__(self) -> int:
        """Return the number of photographs."""
        return len(self.files)

    def __getitem__(self, index: int) -> NDArray[Any]:
        """Read one photograph, (V, U) or (V, U, 3) of the type of all.

        Raises
        ------
        InputError
            If the file cannot be read, or differs from the first in size, channels or depth.
        """
        path, page = self.files[index]
        image = read_colour(path, page=page)
        if image.shape != self.shape or image.dtype != self.dtype:
            expected = f"{self.dtype} of shape {self.shape}, as {self.files[0][0].name} has"
            got = f"{image.dtype} of shape {image.shape}"
            raise InputError(f"{path}[{page}]" if page else path, expected, got)
        return image

    def __iter__(self) -> Iterator[NDArray[Any]]:
        """Read one photograph after the other."""
        return (self[index] for index in range(len(self)))

    @property
    def luminance(self) -> "Luminance":
        """The same stack in grey: luma ``0.299 R + 0.587 G + 0.114 B``, not rounded."""
        return Luminance(self)


@dataclass(frozen=True)
class Luminance:
    """A stack of photographs in grey, for the measures of focus."""

    photographs: Stack

    def __len__(self) -> int:
        """Return the number of photographs."""
        return len(self.photographs)

    def __getitem__(self, index: int) -> NDArray[Any]:
        """Return one photograph as grey values in digital numbers, (V, U)."""
        return luma(np.asarray(self.photographs[index]))

    def banded(self) -> Banded:
        """Return the same by bands of rows."""
        return _GreyBands(banded(self.photographs, colour=True))


class _GreyBands:
    """Photographs in grey by bands of rows."""

    def __init__(self, whole: Banded) -> None:
        self._whole, self.shape = whole, whole.shape[:2]

    def __len__(self) -> int:
        return len(self._whole)

    def rows(self, index: int, top: int, bottom: int) -> NDArray[Any]:
        return luma(self._whole.rows(index, top, bottom))


def luma(image: NDArray[Any]) -> NDArray[Any]:
    """Return a picture in grey, (V, U)."""
    return image if image.ndim == 2 else image @ _LUMA
