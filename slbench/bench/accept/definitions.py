"""The tests of an acceptance: what each of them measures, and in whose words.

*Followed are the definitions of* VDI/VDE 2634 part 2 (2012; single views), VDI/VDE 2634 part 3
(2008; several registered views) and ISO 10360-13:2021.  It is *no accredited procedure*: who
accepts a scanner by contract needs the documents themselves, a calibrated artefact and its
certificate.

- *Probing error, form* (VDI PF): range of the points' distances from the centre of their
  least-squares sphere, radius free, after 0.3 % of the points have been set aside.  ISO's
  dispersion value takes the thinnest shell about that centre that holds 95 % of the points.
- *Probing error, size* (VDI PS, ISO size by all points): measured minus certified diameter.
- *Sphere-spacing error* (VDI SD, ISO distortion error of centre to centre): measured minus
  certified distance of two centres.
- *Flatness error* (VDI F; ISO flat-form distortion by 95 %): as form, about a least-squares plane.
- *Length measurement error* (E, bidirectional): of the distance between the far ends of two balls
  along the line of their centres, measured minus certified.

What is uncertain: the ends of a ball bar that look away cannot be seen from one side, so that a
bidirectional length is put together from the spacing and both fitted diameters, ``E = SD + (PS_1 +
PS_2) / 2``; VDI/VDE 2634-3 has rules of its own for putting spacing and probing errors together,
which were not at hand word by word.  Nor were ISO's symbols: they are written as its 2021
edition's terms are commonly cited (SMV: sensor measurement volume, CMV: concatenated, SV and MV:
single and multiple views).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

StandardKind = Literal["sphere", "ball_bar", "plane"]
#: Of standards, in the order in which they are measured.
STANDARDS: tuple[StandardKind, ...] = ("sphere", "ball_bar", "plane")

#: Least number of places of each standard (VDI/VDE 2634-2).
LEAST_PLACES: dict[StandardKind, int] = {"sphere": 10, "ball_bar": 7, "plane": 6}

#: Share of the points in ISO's dispersion values.
DISPERSION_SHARE = 0.95


@dataclass(frozen=True)
class ErrorKind:
    """One kind of error that is tested.

    Parameters
    ----------
    name : str
        As in files and options.
    words : str
        For tables.
    symbol, iso : str
        In VDI/VDE 2634, and in ISO 10360-13 without volume and view.
    standard : {"sphere", "ball_bar", "plane"}
    signed : bool
        Whether it is a measured minus a certified size; a range otherwise.
    """

    name: str
    words: str
    symbol: str
    iso: str
    standard: StandardKind
    signed: bool

    def label(self, views: int = 1) -> str:
        """Return both symbols as they are shown, for single or several registered views."""
        kind = "SMV.SV" if views == 1 else "CMV.MV"
        iso = f"{self.iso}:{kind}:O3D" if self.iso else ""
        return ", ".join(symbol for symbol in (self.symbol, iso) if symbol)


_TESTS = (
    ErrorKind("probing_form", "probing form", "PF", "", "sphere", False),
    ErrorKind("probing_dispersion", "probing dispersion", "", "PForm.Sph.D95%", "sphere", False),
    ErrorKind("probing_size", "probing size", "PS", "PSize.Sph.All", "sphere", True),
    ErrorKind("sphere_spacing", "sphere spacing", "SD", "DCC", "ball_bar", True),
    ErrorKind("length", "length, bidirectional", "E", "EBi", "ball_bar", True),
    ErrorKind("flatness", "flatness", "F", "", "plane", False),
    ErrorKind("flat_dispersion", "flat dispersion", "", "DForm.Pla.D95%", "plane", False),
)
#: All tests by name.
TESTS: dict[str, ErrorKind] = {test.name: test for test in _TESTS}
