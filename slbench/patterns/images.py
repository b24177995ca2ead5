"""Pictures of any kind as a code, decoded by matching: ``kind = "images"``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.natural import natural
from slbench.core.validation.types import Blur
from slbench.patterns.base import Axis, Code, FloatArray, Panel, Variation
from slbench.patterns.matching.code import MatchedCode


@dataclass(frozen=True, eq=False)
class Images(MatchedCode):
    """Pictures that code one panel axis or both.

    Pictures that are the same along one axis are matched along the other; any others over the whole
    panel (:mod:`slbench.patterns.matching.plane`).

    Parameters
    ----------
    pictures : (N, H, W) uint8 or uint16
        What the panel shows, its type's whole range.
    coded : {"u", "v", "uv"}
        Axes that are decoded; ``axes`` in a table.
    files : str
        Names of the files: one with a ``*``, the numbers in natural order.
    blur_px : float
        Standard deviation of the blur of lens and panel that pixels are matched with, px.  What is
        shown stays sharp.  By default 0: matched with what is shown.

    Raises
    ------
    InputError
        For pictures of another shape or type, and a blur that is none.
    """

    kind: ClassVar[str] = "images"

    pictures: NDArray[Any]
    coded: Literal["u", "v", "uv"] = "uv"
    files: str = "images_*.png"
    blur_px: Blur = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pictures.ndim != 3 or self.pictures.dtype not in (np.uint8, np.uint16):
            got = f"{self.pictures.dtype} of shape {self.pictures.shape}"
            raise InputError("Images: files", "grey pictures of 8 or 16 bit", got)
        if self.files.count("*") != 1 or Path(self.files).suffix.lower() != ".png":
            raise InputError("Images: files", 'a name with one *, such as "mine_*.png"', self.files)
        most = 0.1 * min(self.pictures.shape[1:])
        if not 0.0 <= self.blur_px <= most:
            raise InputError("Images: blur_px", f"0 to {most:g} panel pixels", self.blur_px)

    def __eq__(self, other: object) -> bool:
        """Return whether both code the same axes by the same pictures, alike."""
        if not isinstance(other, Images):
            return NotImplemented
        same = (
            self.coded == other.coded
            and self.blur_px == other.blur_px
            and self.pictures.dtype == other.pictures.dtype
        )
        return same and np.array_equal(self.pictures, other.pictures)

    def __hash__(self) -> int:
        """Return a hash of the pictures."""
        return hash((self.coded, self.blur_px, self.pictures.shape, self.pictures.tobytes()))

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The decoded axes."""
        return cast(tuple[Axis, ...], tuple(self.coded))

    def n_frames(self, panel: Panel) -> int:
        """Return the number of pictures."""
        return len(self.pictures)

    def varies(self, k: int) -> Variation:
        """Return the coded axis where all pictures are the same along the other, else "uv"."""
        if self.coded == "u" and not np.any(self.pictures != self.pictures[:, :1]):
            return "u"
        if self.coded == "v" and not np.any(self.pictures != self.pictures[:, :, :1]):
            return "v"
        return "uv"

    def profile(self, k: int, size: int) -> FloatArray:
        """Return picture `k` along the one axis that it varies along, (size,)."""
        picture = self.pictures[k]
        return self._levels(picture[0] if self.coded == "u" else picture[:, 0])

    def image(self, k: int, panel: Panel) -> FloatArray:
        """Return picture `k`, (H, W) in [0, 1]."""
        return self._levels(self.pictures[k])

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for pictures of another size than the panel."""
        height, width = self.pictures.shape[1:]
        if (width, height) != tuple(panel):
            expected = f"pictures of the panel's {panel[0]} x {panel[1]} px"
            raise InputError("Images: files", expected, f"{width} x {height} px")

    @classmethod
    def from_table(cls, table: Mapping[str, Any], folder: Path | None) -> Self:
        """Read the pictures that ``files`` names, in natural order.

        Raises
        ------
        InputError
            For an unknown key, no such files, files outside the folder, or unlike pictures.
        """
        from slbench.core.io.images import read_grey
        from slbench.core.resources import inside

        for key in table:
            if key not in ("axes", "files", "blur_px"):
                raise InputError(f"Images: {key}", "one of the keys axes, files, blur_px", key)
        pattern, coded = table.get("files"), table.get("axes", "uv")
        if not isinstance(pattern, str) or pattern.count("*") != 1:
            expected = 'names of pictures such as "mine_*.png"'
            raise InputError("Images: files", expected, repr(pattern))
        if coded not in ("u", "v", "uv"):
            raise InputError("Images: axes", '"u", "v" or "uv"', repr(coded))
        base = Path(".") if folder is None else folder
        inside(base, pattern.replace("*", "_"))
        paths = sorted(base.glob(pattern), key=lambda path: natural(path.name))
        if not paths:
            raise InputError("Images: files", f"pictures in {base}", f"no {pattern}")
        pictures = [read_grey(inside(base, path.relative_to(base))) for path in paths]
        for path, one in zip(paths, pictures, strict=True):
            if one.shape != pictures[0].shape or one.dtype != pictures[0].dtype:
                expected = f"pictures like {paths[0].name}"
                raise InputError("Images: files", expected, f"{path.name}, of other size or depth")
        return cls(np.array(pictures), coded, pattern, table.get("blur_px", 0.0))

    def to_table(self, folder: Path | None) -> dict[str, Any]:
        """Return the table; the pictures are written beside it, numbered.

        Those of a second code go to a folder of their own, ``2/``.
        """
        known = {"blur_px": self.blur_px} if self.blur_px else {}
        if folder is None:
            return {"axes": self.coded, "files": self.files} | known
        from slbench.core.io.images import write_png

        files, k = self.files, 1
        while any((folder / files).parent.glob("*.png")):
            k += 1
            files = f"{k}/{self.files}"
        digits = len(str(len(self.pictures) - 1))
        for k, picture in enumerate(self.pictures):
            path = folder / files.replace("*", f"{k:0{digits}d}")
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, picture)
        return {"axes": self.coded, "files": files} | known

    @property
    def word(self) -> str:
        """``images(12)``, which is not read back."""
        return f"images({len(self.pictures)})"

    def _levels(self, picture: NDArray[Any]) -> FloatArray:
        levels: FloatArray = picture / float(np.iinfo(picture.dtype).max)
        return levels
