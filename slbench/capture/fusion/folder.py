"""Folders of photographs as stacks: frames in order of their names, read when asked for."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.fusion.stack import Banded, Stack, banded
from slbench.core.errors import InputError
from slbench.core.io import read_colour
from slbench.core.natural import natural
from slbench.core.show.display import brief

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
_LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)  # ITU-R BT.601


@dataclass(frozen=True)
class Photographs:
    """A stack of photographs on disk; index it, and the file is read.

    Attributes
    ----------
    files : tuple of Path
        The photographs.
    shape : tuple of int
        (V, U) for grey ones, (V, U, 3) for colour.
    dtype : numpy dtype
        uint8 or uint16.
    """

    files: tuple[Path, ...]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    __repr__ = brief

    @classmethod
    def open(cls, folder: str | Path) -> "Photographs":
        """Find the PNG, TIFF and JPEG files of a folder, ``f2`` ahead of ``f10``.

        Files whose names begin with a dot, and those of other kinds, are passed over.

        Parameters
        ----------
        folder : str or Path

        Raises
        ------
        InputError
            If it is no folder, has fewer than two photographs, or the first cannot be read.
        """
        folder = Path(folder)
        if not folder.is_dir():
            got = "a file" if folder.exists() else "nothing of that name"
            raise InputError(folder, "a folder of photographs", got)
        files = [
            path
            for path in folder.iterdir()
            if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
        ]
        if len(files) < 2:
            raise InputError(folder, "at least 2 photographs (PNG, TIFF or JPEG)", len(files))
        files.sort(key=lambda path: natural(path.name))
        first = read_colour(files[0])
        return cls(tuple(files), first.shape, first.dtype)

    def __len__(self) -> int:
        """Return the number of photographs."""
        return len(self.files)

    def __getitem__(self, index: int) -> NDArray[Any]:
        """Read one photograph, (V, U) or (V, U, 3) of uint8 or uint16.

        Raises
        ------
        InputError
            If the file cannot be read, or differs from the first in size, channels or depth.
        """
        image = read_colour(self.files[index])
        if image.shape != self.shape or image.dtype != self.dtype:
            expected = f"{self.dtype} of shape {self.shape}, as {self.files[0].name} has"
            raise InputError(self.files[index], expected, f"{image.dtype} of shape {image.shape}")
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
        return _grey(np.asarray(self.photographs[index]))

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
        return _grey(self._whole.rows(index, top, bottom))


def _grey(image: NDArray[Any]) -> NDArray[Any]:
    return image if image.ndim == 2 else image @ _LUMA
