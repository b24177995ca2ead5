"""``[camera]`` and ``[projector]`` of a scene file: the model's keys, and those of data sheets.

What a data sheet states (:mod:`~slbench.scene.devices.datasheet`) may be written as it stands
there: each of its keys is in the place of one of the model's, and is turned into it when the device
is made.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, model_validator

from slbench.core.units import MILLIMETRES
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import (
    FINITE,
    Aperture,
    Barrel,
    Blur,
    Distortion,
    Fraction,
    Interval,
    Measure,
    NotNegative,
    Pair,
    Pixels,
    Shading,
    TiltDegrees,
)
from slbench.rig import Lens
from slbench.rig.optics.response import ResponseCurve
from slbench.scene.devices import datasheet
from slbench.scene.devices.datasheet import Micromirrors

#: Per cent of a picture by which a lens moves it: ultra-short throws have some 300.
_Offset = Annotated[float, FINITE, Interval(ge=-1000.0, le=1000.0)]


class Optics(Parameters):
    """What camera and projector have in common."""

    #: Keys of data sheets that tell the principal distance, and the pixels' pitch.
    _LENSES: ClassVar[tuple[str, ...]] = ("lens_mm",)
    _PITCHES: ClassVar[tuple[str, ...]] = ()

    resolution_px: tuple[Pixels, Pixels]
    pitch_um: Measure | tuple[Measure, Measure] | None = None
    focal_length_mm: Measure | None = None
    f_number: Measure | None = None
    aperture_radius_mm: NotNegative | None = None
    focus_distance_mm: Measure | None = None
    magnification: Measure | None = None
    numerical_aperture: Aperture | None = None
    natural_vignetting: bool = True
    wavelength_nm: NotNegative = 0.0
    blur_px: Blur = 0.0
    principal_point_px: Pair | None = None
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    tilt_deg: tuple[TiltDegrees, TiltDegrees] = (0.0, 0.0)
    body_mm: tuple[Measure, Measure, Measure] | None = None
    barrel_mm: Barrel | None = None
    # By the data sheet of the lens: focal length and the f-number engraved on it.
    lens_mm: Measure | None = None
    lens_f_number: Measure | None = None

    @model_validator(mode="after")
    def _one_lens(self) -> Optics:
        lens = "focal_length_mm (perspective) or magnification (telecentric)"
        self._one_of(("focal_length_mm", "magnification"), self._LENSES, lens)
        self._one_of(("pitch_um",), self._PITCHES, "pitch_um")
        self._at_most_one(("f_number", "aperture_radius_mm", "lens_f_number"))
        if self.magnification is None and self.numerical_aperture is not None:
            raise ValueError("numerical_aperture with a telecentric lens only")
        aperture = self.f_number or self.aperture_radius_mm or self.lens_f_number
        if self.magnification is not None and aperture:
            raise ValueError("numerical_aperture, not f_number or a radius, with a magnification")
        _ = self.pitches_um  # refuses what is no format of a sensor
        return self

    def _one_of(self, keys: tuple[str, ...], sheet: tuple[str, ...], words: str) -> None:
        """Refuse all but one of the model's keys, which words name, and a data sheet's."""
        if sum(getattr(self, key) is not None for key in (*keys, *sheet)) != 1:
            raise ValueError(f"{words}, or by a data sheet {' or '.join(sheet)}; one of them")

    def _at_most_one(self, keys: tuple[str, ...]) -> None:
        stated = [key for key in keys if getattr(self, key) is not None]
        if len(stated) > 1:
            raise ValueError(f"{' or '.join(stated[:2])}, not both")

    @property
    def pitches_um(self) -> tuple[float, float]:
        """Pitch of the pixels along u and v, um, by whichever key states it."""
        assert self.pitch_um is not None  # by _one_lens
        return self.pitch_um if isinstance(self.pitch_um, tuple) else (self.pitch_um,) * 2

    @property
    def axis_px(self) -> tuple[float, float] | None:
        """Principal point (u, v), px, by whichever key states it; None: the centre."""
        return self.principal_point_px

    def principal_distance_mm(self, focus_mm: float) -> float:
        """Return the principal distance of a perspective lens that is in focus somewhere.

        Raises
        ------
        InputError
            For a focus within the focal length.
        """
        if self.lens_mm is not None:
            return datasheet.principal_distance_mm(self.lens_mm, focus_mm)
        assert self.focal_length_mm is not None  # by _one_lens
        return self.focal_length_mm

    def arguments(self, distance_mm: float) -> dict[str, Any]:
        """Return the arguments of a device, focused at `distance_mm` by default.

        Raises
        ------
        InputError
            For a lens that cannot be focused there.
        """
        focus = self.focus_distance_mm or distance_mm
        if self.magnification is not None:
            lens = Lens.telecentric(self.magnification, self.numerical_aperture or 0.0, focus)
        else:
            principal = self.principal_distance_mm(focus)
            radius, number = self.aperture_radius_mm or 0.0, self.f_number
            if self.lens_f_number is not None:
                focal = self.lens_mm or datasheet.focal_length_mm(principal, focus)
                number = datasheet.working_f_number(self.lens_f_number, principal / focal - 1.0)
            if number is not None:
                radius = principal / (2.0 * number)
            lens = Lens(principal, radius, focus, natural_vignetting=self.natural_vignetting)
        lens = replace(lens, wavelength_nm=self.wavelength_nm)
        pitch = self.pitches_um
        return {
            "width": self.resolution_px[0],
            "height": self.resolution_px[1],
            "pitch_mm": (pitch[0] * 1e-3, pitch[1] * 1e-3),
            "lens": lens,
            "principal_point": self.axis_px,
            "distortion": self.distortion,
            "blur_px": self.blur_px,
            "body_mm": self.body_mm,
            "barrel_mm": self.barrel_mm,
            "tilt_rad": (float(np.deg2rad(self.tilt_deg[0])), float(np.deg2rad(self.tilt_deg[1]))),
        }


class CameraOptics(Optics):
    """The optical keys of a camera."""

    _PITCHES: ClassVar[tuple[str, ...]] = ("sensor_format",)

    fill_factor: Fraction = 1.0
    shading: Shading = ()
    # By the data sheets of sensor and lens: formats, in inches.
    sensor_format: str | None = None
    lens_format: str | None = None

    @model_validator(mode="after")
    def _lens_of_a_format(self) -> CameraOptics:
        if self.lens_format is not None:
            datasheet.format_diagonal_mm(self.lens_format, "lens_format")
        return self

    @property
    def pitches_um(self) -> tuple[float, float]:
        """Pitch of the pixels along u and v, um, by whichever key states it."""
        if self.sensor_format is None:
            return super().pitches_um
        diagonal = datasheet.format_diagonal_mm(self.sensor_format)
        return datasheet.panel_pitches_um(diagonal, *self.resolution_px)

    def arguments(self, distance_mm: float) -> dict[str, Any]:
        """Return the arguments of Camera, focused at `distance_mm` by default."""
        own = {"fill_factor": self.fill_factor, "shading": self.shading}
        return super().arguments(distance_mm) | own


class ProjectorOptics(Optics):
    """The optical keys of a projector, and its light."""

    _LENSES: ClassVar[tuple[str, ...]] = ("lens_mm", "throw_ratio")
    _PITCHES: ClassVar[tuple[str, ...]] = ("micromirror_um", "panel_inch")

    flux_w: Measure = 1.0
    bit_depth: Annotated[int, Field(ge=0, le=16)] = 8
    gamma: Measure = 1.0
    # In the place of gamma; a file of it is read first (slbench.scene.file.extended).
    response: ResponseCurve | None = None
    # By the data sheets of panel and projector:
    micromirror_um: Measure | None = None
    panel_inch: Measure | None = None
    micromirrors: Micromirrors = "orthogonal"
    throw_ratio: Measure | None = None
    zoom: Measure = 1.0
    offset_percent: _Offset | None = None
    lens_shift_percent: _Offset | None = None
    flux_lm: Measure | None = None

    @model_validator(mode="after")
    def _one_projector(self) -> ProjectorOptics:
        self._at_most_one(("principal_point_px", "offset_percent", "lens_shift_percent"))
        if self.flux_lm is not None and "flux_w" in self.model_fields_set:
            raise ValueError("flux_w or flux_lm, not both")
        if self.zoom != 1.0 and self.throw_ratio is None:
            raise ValueError("zoom with a throw_ratio only")
        if self.micromirrors == "diamond" and self.pitch_um is not None:
            raise ValueError("micromirrors with micromirror_um or panel_inch only")
        return self

    @property
    def pitches_um(self) -> tuple[float, float]:
        """Pitch of the pixels along u and v, um, by whichever key states it."""
        if self.micromirror_um is not None:
            return datasheet.micromirror_pitches_um(self.micromirror_um, self.micromirrors)
        if self.panel_inch is not None:
            diagonal = self.panel_inch * MILLIMETRES["inch"]
            return datasheet.panel_pitches_um(diagonal, *self.resolution_px, self.micromirrors)
        return super().pitches_um

    @property
    def axis_px(self) -> tuple[float, float] | None:
        """Principal point (u, v), px, by whichever key states it; None: the centre."""
        offset = self.offset_percent
        if self.lens_shift_percent is not None:
            offset = datasheet.shift_offset_percent(self.lens_shift_percent)
        if offset is None:
            return super().axis_px
        columns, rows = self.resolution_px
        return (columns - 1) / 2.0, datasheet.axis_row_px(rows, offset)

    def principal_distance_mm(self, focus_mm: float) -> float:
        """Return the principal distance of a perspective lens that is in focus somewhere."""
        if self.throw_ratio is None:
            return super().principal_distance_mm(focus_mm)
        width = self.resolution_px[0] * self.pitches_um[0] * 1e-3
        return datasheet.throw_principal_distance_mm(self.throw_ratio, width, self.zoom)

    def arguments(self, distance_mm: float) -> dict[str, Any]:
        """Return the arguments of Projector, focused at `distance_mm` by default."""
        flux = self.flux_w if self.flux_lm is None else datasheet.radiant_flux_w(self.flux_lm)
        light = {"flux_w": flux, "bit_depth": self.bit_depth or None, "gamma": self.gamma}
        return super().arguments(distance_mm) | light | {"curve": self.response}
