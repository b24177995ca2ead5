"""What data sheets state, turned into what the model takes.

Pure functions, one a number.  The keys of ``[camera]``, ``[projector]`` and ``[detector]`` that are
a data sheet's own (:mod:`slbench.scene.devices.optics`) go through them when a scene is loaded.

A lens is a thin one here: principal planes in one place, pupils of the size of the aperture.  Its
distances are from that plane, while data sheets measure from the front of the housing, some
centimetres nearer to the object.

Sources: EMVA Standard 1288, release 4.0; Texas Instruments DLPA044, "Geometric Optics for DLP".
"""

from __future__ import annotations

import math
import re
from typing import Literal

from slbench.core.errors import InputError
from slbench.core.show.display import length

#: How micromirrors stand on a panel: along its sides, or turned by 45 degrees.
Micromirrors = Literal["orthogonal", "diamond"]

#: Millimetres of a sensor's diagonal for an inch of its format: that of the picture in a camera
#: tube of that diameter.  Formats of less than half an inch have the second.
_TUBE_MM, _SMALL_TUBE_MM = 16.0, 18.0
_HALF_INCH = 0.5
_FORMAT = re.compile(r'\s*(\d+(?:\.\d+)?)(?:\s*/\s*(\d+(?:\.\d+)?))?\s*(?:"|”|inch)?\s*')
#: Formats that are made, inch.
_FORMATS = (0.05, 4.0)
#: Distances in focus that may be metres, mm.
_METRES = 10.0
#: Lumens of a watt of white light of three LEDs: typical.  Light of one wavelength has 683 times
#: the eye's sensitivity, from 40 (blue, 460 nm) to 683 (green, 555 nm).
WHITE_LM_PER_W = 300.0


# -- lenses -------------------------------------------------------------------------------------


def principal_distance_mm(lens_mm: float, focus_distance_mm: float) -> float:
    """Return the principal distance of a lens in focus, ``c = f d / (d - f)``.

    Parameters
    ----------
    lens_mm : float
        Focal length ``f`` by the data sheet.
    focus_distance_mm : float
        Distance in focus ``d``, from the lens; infinity is allowed.

    Returns
    -------
    float
        From the lens to its sensor, mm.

    Raises
    ------
    InputError
        For a distance within the focal length, of which there is no real image.
    """
    f, d = lens_mm, focus_distance_mm
    if d > f:
        return f if math.isinf(d) else f * d / (d - f)
    got = length(d)
    if d < _METRES and 1e3 * d > 2 * f:
        got += f"; in metres it would be {length(1e3 * d)}"
    raise InputError("focus_distance_mm", f"a distance beyond the focal length, {length(f)}", got)


def focal_length_mm(principal_distance_mm: float, focus_distance_mm: float) -> float:
    """Return the focal length of a lens by its principal distance, ``f = c d / (c + d)``, mm."""
    c, d = principal_distance_mm, focus_distance_mm
    return c if math.isinf(d) else c * d / (c + d)


def working_f_number(f_number: float, magnification: float) -> float:
    """Return the f-number of the light on the sensor, ``N (1 + m)``.

    Parameters
    ----------
    f_number : float
        ``N``, focal length over aperture: what is engraved on the lens.
    magnification : float
        ``m``, picture over object: ``f / (d - f)``.

    Returns
    -------
    float
        Principal distance over aperture, which is the model's f-number
        (:attr:`slbench.rig.Lens.f_number`, ``f_number`` of a scene).
    """
    return f_number * (1.0 + magnification)


# -- sensors and panels -------------------------------------------------------------------------


def format_diagonal_mm(sensor_format: str, where: str = "sensor_format") -> float:
    """Return the diagonal of a sensor of a format in inches: ``1/1.8``, ``2/3``, ``1.1``.

    An inch is 16 mm, and 18 mm where the format is below 1/2.  Sensors of one format differ by
    some 3 %: where the sheet has a pixel pitch, that is the number to take.

    Parameters
    ----------
    sensor_format : str
        A number or a fraction, ``"`` or ``inch`` after it or not.
    where : str
        What to name in a refusal.

    Returns
    -------
    float
        Millimetres.

    Raises
    ------
    InputError
        For anything else, and for what no sensor is.

    Examples
    --------
    >>> format_diagonal_mm('2/3"'), format_diagonal_mm("1/3")
    (10.666666666666666, 6.0)
    """
    found = _FORMAT.fullmatch(sensor_format)
    inch = float(found[1]) / (float(found[2] or 1.0) or math.inf) if found else 0.0
    if not _FORMATS[0] <= inch <= _FORMATS[1]:
        raise InputError(where, "a format such as 1/1.8, 2/3 or 1.1", repr(sensor_format))
    return inch * (_TUBE_MM if inch >= _HALF_INCH else _SMALL_TUBE_MM)


def panel_pitches_um(
    diagonal_mm: float, columns: int, rows: int, layout: Micromirrors = "orthogonal"
) -> tuple[float, float]:
    """Return the pitches of a sensor's or panel's columns and rows by its diagonal.

    Parameters
    ----------
    diagonal_mm : float
    columns, rows : int
    layout : {"orthogonal", "diamond"}
        See :func:`micromirror_pitches_um`.

    Returns
    -------
    (float, float)
        Along u and v, um.
    """
    flat = 1.0 if layout == "orthogonal" else 0.5  # of rows, in pitches of columns
    pitch = 1e3 * diagonal_mm / math.hypot(columns, flat * rows)
    return pitch, flat * pitch


def micromirror_pitches_um(
    micromirror_um: float, layout: Micromirrors = "orthogonal"
) -> tuple[float, float]:
    """Return the pitches of a DMD's columns and rows by that of its micromirrors.

    Square micromirrors of the pitch ``p`` that are turned by 45 degrees ("diamond") have columns
    ``sqrt(2) p`` apart and rows ``p / sqrt(2)``.  Every other row is half a column aside, which the
    model's grid leaves out: a quarter of a column from its mean at most.

    Parameters
    ----------
    micromirror_um : float
        From a micromirror's centre to its neighbour's across the edge that they share.
    layout : {"orthogonal", "diamond"}

    Returns
    -------
    (float, float)
        Along u and v, um.

    Examples
    --------
    The DLP4500, 912 x 1140: 9.85 x 6.16 mm.

    >>> u, v = micromirror_pitches_um(7.637, "diamond")
    >>> round(912 * u), round(1140 * v)
    (9850, 6156)
    """
    if layout == "orthogonal":
        return micromirror_um, micromirror_um
    return math.sqrt(2.0) * micromirror_um, micromirror_um / math.sqrt(2.0)


# -- projectors ---------------------------------------------------------------------------------


def throw_principal_distance_mm(
    throw_ratio: float, panel_width_mm: float, zoom: float = 1.0
) -> float:
    """Return the principal distance of a projector by its throw ratio.

    Rays through the middle of the lens make similar triangles of panel and picture: distance over
    the picture's width is principal distance over the panel's.

    Parameters
    ----------
    throw_ratio : float
        Distance from the lens over the picture's width; of a zoom lens the smallest, at its wide
        end.
    panel_width_mm : float
    zoom : float
        By how much the lens is zoomed in: 1 at the wide end.

    Returns
    -------
    float
        Millimetres.
    """
    return throw_ratio * zoom * panel_width_mm


def axis_row_px(rows: int, offset_percent: float) -> float:
    """Return the row of a panel where the axis of a lens with an offset meets it.

    Parameters
    ----------
    rows : int
    offset_percent : float
        How far the picture's middle is above the axis, in per cent of half its height: 0 has the
        axis in the middle, 100 in the bottom edge (DLPA044; Christie, Optoma).

    Returns
    -------
    float
        Row of the principal point, px; ``rows - 0.5`` is the bottom edge.
    """
    return (rows - 1) / 2.0 + rows / 2.0 * offset_percent / 100.0


def shift_offset_percent(lens_shift_percent: float) -> float:
    """Return the offset of a lens shift, which is stated in per cent of the whole height."""
    return 2.0 * lens_shift_percent


def radiant_flux_w(flux_lm: float, lm_per_w: float = WHITE_LM_PER_W) -> float:
    """Return the radiant flux of a luminous one, W, by the light's efficacy in lumens a watt."""
    return flux_lm / lm_per_w


# -- detectors (EMVA 1288) ----------------------------------------------------------------------


def saturation_e(snr_max_db: float) -> float:
    """Return the saturation capacity, electrons, by the largest signal-to-noise ratio.

    Shot noise alone limits it: ``SNR_max = sqrt(saturation)``, and decibels are
    ``20 log10 SNR`` (EMVA 1288, 2.3 and 2.6).
    """
    return float(10.0 ** (snr_max_db / 10.0))


def dark_noise_e(saturation_e: float, dynamic_range_db: float) -> float:
    """Return the temporal dark noise, electrons, by the dynamic range.

    The range ends below where signal equals noise, ``sqrt(sigma^2 + 1/4) + 1/2`` electrons (EMVA
    1288, 2.6); sigma has the noise of the quantisation in it.

    Raises
    ------
    InputError
        For a range that needs less than no noise.
    """
    least = saturation_e / 10.0 ** (dynamic_range_db / 20.0)
    if least < 1.0:
        most = 20.0 * math.log10(saturation_e)
        expected = f"at most {most:.4g} dB, as the saturation of {saturation_e:.4g} e counts"
        raise InputError("dynamic_range_db", expected, f"{dynamic_range_db:g}")
    return math.sqrt((least - 0.5) ** 2 - 0.25)
