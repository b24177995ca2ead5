"""Lenses: perspective (pinhole or thin lens) and object-space telecentric (see device.py)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.types import Aperture, Ge, Measure, NotNegative, Positive
from slbench.core.validation.values import Value, checked


@dataclass(frozen=True)
class Lens(Value):
    """A lens: perspective (pinhole or thin lens) or object-space telecentric.

    Parameters
    ----------
    focal_length_mm : float
        Principal distance ``c``.  For a telecentric lens it is ``magnification *
        focus_distance_mm``; use :meth:`telecentric`.
    aperture_radius_mm : float
        Radius of the entrance pupil; 0 is a pinhole.  For a telecentric lens: the radius of
        the cone of accepted rays at the distance in focus.
    focus_distance_mm : float
        Distance from the nodal point to the plane in focus, along the axis.
    kind : {"perspective", "telecentric"}
    natural_vignetting : bool
        Whether the cos^4 law holds.  False describes a lens corrected for uniform
        illumination.  A telecentric lens has none.
    wavelength_nm : float
        Of the light that diffraction is counted with, nm; 0 is geometric optics.  A pinhole
        has no diffraction: it is the ideal of sharpness.
    all_in_focus : bool
        Whether the lens is sharp at every distance: what a perfect focus stack sees.  Its
        aperture lets light through and diffracts, but does not defocus.
    """

    focal_length_mm: Measure
    aperture_radius_mm: NotNegative = 0.0
    focus_distance_mm: Annotated[float, Ge(1e-9)] = np.inf
    kind: Literal["perspective", "telecentric"] = "perspective"
    natural_vignetting: bool = True
    wavelength_nm: NotNegative = 0.0
    all_in_focus: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind == "telecentric" and not np.isfinite(self.focus_distance_mm):
            raise InputError(
                "lens: focus_distance_mm", "a finite distance for a telecentric lens", "infinity"
            )

    @classmethod
    @checked
    def telecentric(
        cls, magnification: Positive, numerical_aperture: Aperture, focus_distance_mm: Positive
    ) -> Self:
        """Return an object-space telecentric lens.

        Parameters
        ----------
        magnification : float
            Image size over object size.
        numerical_aperture : float
            Object-side numerical aperture, in [0, 1).
        focus_distance_mm : float
        """
        radius = focus_distance_mm * np.tan(np.arcsin(numerical_aperture))
        return cls(magnification * focus_distance_mm, radius, focus_distance_mm, "telecentric")

    def refocused(self, distance_mm: float) -> Self:
        """Return the lens focused at another distance, its perspective unchanged."""
        scale = distance_mm / self.focus_distance_mm if self.kind == "telecentric" else 1.0
        return replace(
            self,
            focal_length_mm=scale * self.focal_length_mm,
            aperture_radius_mm=scale * self.aperture_radius_mm,
            focus_distance_mm=distance_mm,
        )

    @property
    def magnification(self) -> float:
        """Lateral magnification in the plane in focus."""
        return self.focal_length_mm / self.focus_distance_mm

    @property
    def defocusing_radius_mm(self) -> float:
        """Radius of the pupil that defocuses: the aperture's, or 0 where all is in focus."""
        return 0.0 if self.all_in_focus else self.aperture_radius_mm

    @property
    def diffraction_mm(self) -> float:
        """Unit of diffraction ``lambda / NA`` on the panel, mm; 0 in geometric optics."""
        if self.aperture_radius_mm == 0:
            return 0.0
        return 1e-6 * self.wavelength_nm * self.focal_length_mm / self.aperture_radius_mm

    @property
    def f_number(self) -> float:
        """Image-side f-number: principal distance over aperture diameter (inf: pinhole).

        For the telecentric lens this is ``1 / (2 tan theta')`` with ``tan theta' = tan theta /
        m``, which is the same expression.
        """
        if self.aperture_radius_mm == 0:
            return np.inf
        return self.focal_length_mm / (2.0 * self.aperture_radius_mm)
