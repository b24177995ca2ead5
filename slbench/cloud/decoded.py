"""What decoding a capture gives: panel coordinates, and points where its rig is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slbench.capture.capture import Capture
from slbench.capture.doubts import exposure_doubt
from slbench.cloud.triangulation import PointCloud, triangulate
from slbench.core.errors import warn_user
from slbench.core.io import OutputFolder, write_exr, write_json, write_ply
from slbench.core.show.display import brief
from slbench.patterns import PhaseMap

DECODED_FOLDER = OutputFolder("decoded capture", ("phase.exr", "cloud.ply", "decode.json"))


@dataclass(frozen=True, eq=False)
class Decoded:
    """A capture decoded, and triangulated where its rig is known.

    Parameters
    ----------
    capture : Capture
    phase : PhaseMap
    cloud : PointCloud or None
        None without a rig.
    """

    capture: Capture
    phase: PhaseMap
    cloud: PointCloud | None

    __repr__ = brief

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of the whole, for JSON."""
        cloud = self.cloud
        return {
            "patterns": self.capture.sequence.name,
            "frames": len(self.capture.frames),
            "valid_pixels": int(np.count_nonzero(self.phase.mask)),
            "points": None if cloud is None else len(cloud),
            "predicted_sigma_mm": float(np.median(cloud.sigma_total_mm)) if cloud else None,
        }

    def save(self, folder: str | Path, parameters: Mapping[str, Any]) -> None:
        """Write the maps, the cloud and the numbers; nothing appears until all are complete.

        Parameters
        ----------
        folder : path
            For ``phase.exr`` (``modulation``, ``mean``, ``mask`` and, by axis, ``panel.u`` and
            ``sigma.u``, px; and, where nothing tells fringes apart, ``relative.u.0``, rad, of every
            set in order of projection), ``cloud.ply`` (points and ``sigma``, mm, if there are any),
            ``decode.json`` and ``provenance.json``.
        parameters : mapping
            For the provenance.
        """
        phase, cloud = self.phase, self.cloud
        channels = {
            "modulation": phase.modulation,
            "mean": phase.mean,
            "mask": phase.mask,
            **{f"panel.{axis}": values for axis, values in phase.coordinate.items()},
            **{f"sigma.{axis}": values for axis, values in phase.sigma.items()},
            **{
                f"relative.{axis}.{k}": values
                for axis, sets in phase.relative.items()
                for k, (_, values) in enumerate(sets)
            },
        }
        single = {name: values.astype(np.float32) for name, values in channels.items()}
        with DECODED_FOLDER.writing(folder, parameters, None) as temporary:
            write_exr(temporary / "phase.exr", single)
            if cloud:
                write_ply(temporary / "cloud.ply", cloud.points, {"sigma": cloud.sigma_total_mm})
            write_json(temporary / "decode.json", self.to_dict())


def decode_capture(
    capture: Capture, *, min_modulation: float | None = None, where: object = "capture"
) -> Decoded:
    """Decode a capture, and triangulate it where its rig is known.

    Parameters
    ----------
    capture : Capture
    min_modulation : float, optional
        Least modulation of a valid pixel, DN; as :meth:`Capture.decode` takes it.
    where : object
        What to call the capture in a warning, its folder.

    Returns
    -------
    Decoded

    Warns
    -----
    InputWarning
        If nearly all pixels are saturated or dark.
    """
    phase = capture.decode(min_modulation=min_modulation)
    if doubt := exposure_doubt(capture, phase):
        warn_user(where, doubt)
    cloud = None if capture.rig is None else triangulate(capture.rig, phase)
    return Decoded(capture, phase, cloud)
