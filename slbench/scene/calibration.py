"""What a scene is measured with: another rig, a calibration model, or an error of the calibration.

Light is rendered with the scene's rig, which is true.  Decoded frames become points by what the
operator has: a rig of another file, a model from pixels to millimetres, or the true rig off by an
error that is drawn from a covariance.  All of it is *steady*: a real instrument keeps its
calibration, so repeats share one draw, that of ``seed`` (as they share a detector's fixed
pattern), unless ``redraw`` asks for one a scan.

*Frames.*  Points are in the world of that rig or model, and are compared with the truth in the
scene's.  Neither is turned into the other, unless ``align`` asks for the rigid motion that joins
both over the measurement volume (:mod:`slbench.simulate.reconstruct`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from slbench.calibration.models.model import COORDINATES, CalibrationModel
from slbench.calibration.models.polynomials import Standardisation
from slbench.core import resources
from slbench.core.errors import InputError, located
from slbench.core.random import tagged_seed
from slbench.core.show.display import brief
from slbench.rig import Rig
from slbench.rig.opencv import read_rig
from slbench.rig.parameters import (
    ParameterCovariance,
    covariance_beside,
    moved,
    read_covariance,
)
from slbench.scene.tables import CalibrationTable

#: Tag of the random stream of errors.
_ERRORS = 8


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """What a scene is measured with, instead of its own rig.

    Parameters
    ----------
    rig : Rig or None
        Another rig; None for the scene's own.
    model : CalibrationModel or None
        Instead of any rig.
    covariance : ParameterCovariance or None
        Of the rig's parameters, from which its error is drawn.
    beside : ParameterCovariance or None
        What the rig's own file states of its parameters; nothing is drawn from it.
    seed : int
        Of the draw.
    redraw : bool
        Whether every scan has an error of its own.
    align : bool
        Whether points are moved to the truth by the best rigid motion before they are scored.
    source : str
        In words, for tables.
    digest : str
        Of the files that it was read from.
    """

    rig: Rig | None = None
    model: CalibrationModel | None = None
    covariance: ParameterCovariance | None = None
    beside: ParameterCovariance | None = None
    seed: int = 0
    redraw: bool = False
    align: bool = False
    source: str = ""
    digest: str = field(default="", repr=False)

    __repr__ = brief

    def rig_for(self, own: Rig, seed: int = 0) -> Rig:
        """Return the rig that a scan is measured with.

        Parameters
        ----------
        own : Rig
            The scene's.
        seed : int
            Of the scan, where every scan has a draw of its own.
        """
        rig = self.rig or own
        if self.covariance is None:
            return rig
        tags = (_ERRORS, seed) if self.redraw else (_ERRORS,)
        return moved(rig, self.covariance.draw(tagged_seed(self.seed, *tags)))

    def parameter_covariance(self) -> ParameterCovariance | None:
        """Return what is known of the calibration's parameters, by name; None where nothing is.

        Those of a rig are named as in :mod:`slbench.rig.parameters`, those of a model by coordinate
        and term: ``x.u_c``, in mm, for its standardised inputs.
        """
        if self.model is None:
            return self.covariance
        from scipy.linalg import block_diag

        pairs = list(zip(COORDINATES, self.model.coordinates, strict=True))
        names = tuple(f"{name}.{term}" for name, one in pairs for term in one.form.terms)
        return ParameterCovariance(names, block_diag(*(one.covariance for _, one in pairs)))

    def coarser(self, divisor: int) -> Self:
        """Return the same for a camera of fewer, larger pixels (:meth:`Scene.coarser`)."""
        changes: dict[str, Any] = {}
        if self.rig is not None:
            camera = self.rig.camera.coarser(divisor)
            changes["rig"] = self.rig.having(**{self.rig.only.camera: camera})
        if self.model is not None:
            changes["model"] = _coarser_model(self.model, divisor)
        for name in ("covariance", "beside"):
            if (own := getattr(self, name)) is not None:
                changes[name] = _coarser_covariance(own, divisor)
        return replace(self, **changes)


def _coarser_model(model: CalibrationModel, divisor: int) -> CalibrationModel:
    """Return a model for pixels that are `divisor` of its own wide: u = d u' + (d - 1) / 2."""
    mean, scale = model.standardisation.mean.copy(), model.standardisation.scale.copy()
    mean[:2] = (mean[:2] - 0.5 * (divisor - 1)) / divisor
    scale[:2] = scale[:2] / divisor
    return replace(model, standardisation=Standardisation(mean, scale))


def _coarser_covariance(covariance: ParameterCovariance, divisor: int) -> ParameterCovariance:
    factors = [
        1.0 / divisor if name.startswith("camera.") and name.endswith("_px") else 1.0
        for name in covariance.names
    ]
    matrix = covariance.matrix * factors
    return replace(covariance, matrix=(matrix.T * factors).T)


def read_calibration(table: CalibrationTable, own: Rig, path: Path) -> Calibration:
    """Read a scene's ``[calibration]``; its files stand in the scene's folder.

    Raises
    ------
    InputError
        For a file that cannot be used, and a rig of other devices than the scene's.
    """
    where = f"{path.name}: calibration"
    files: dict[str, Path] = {}
    for name in ("rig", "model", "covariance"):
        if (given := getattr(table, name)) is not None:
            with located(f"{where}.{name}"):
                files[name] = resources.inside(path.parent, given)
    return _read(files, table.deviations(), own, {n: f"{where}.{n}" for n in files}, table)


def calibration_of(path: str | Path, own: Rig, *, align: bool, where: str) -> Calibration:
    """Read what a user measures with: a calibration model (``.json``) or a rig.

    Parameters
    ----------
    path : path
    own : Rig
        The scene's.
    align : bool
        As :class:`Calibration` has it.
    where : str
        What gave it, for messages.
    """
    path = Path(path)
    name = "model" if path.suffix.lower() == ".json" else "rig"
    return _read({name: path}, {}, own, {name: where}, CalibrationTable(rig="-", align=align))


def _read(
    files: Mapping[str, Path],
    deviations: Mapping[str, float],
    own: Rig,
    where: Mapping[str, str],
    table: CalibrationTable,
) -> Calibration:
    """Read the files of a calibration; `where` says of each what named it."""
    rig = model = covariance = beside = None
    words = [str(path.name) for path in files.values()]
    if "rig" in files:
        with located(where["rig"]):
            rig = read_rig(files["rig"], own.only)
            if files["rig"].suffix.lower() in (".yaml", ".yml"):
                beside = covariance_beside(files["rig"])
        _check_devices(rig, own, f"{where['rig']}: {files['rig'].name}")
        # Names of devices do not matter: the scene's are taken.
        pair = own.only
        rig = Rig({pair.camera: rig.camera}, {pair.projector: rig.projector}, own.volume_mm)
    if "model" in files:
        with located(where["model"]):
            model = CalibrationModel.load(files["model"])
    if "covariance" in files:
        with located(where["covariance"]):
            covariance = read_covariance(files["covariance"])
    elif deviations:
        covariance = ParameterCovariance.of(deviations)
        words.append("an error drawn from deviations")
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in files.values())).hexdigest()
    return Calibration(
        rig=rig,
        model=model,
        covariance=covariance,
        beside=beside,
        seed=table.seed,
        redraw=table.redraw,
        align=table.align,
        source=" and ".join(words),
        digest=digest,
    )


def _check_devices(rig: Rig, own: Rig, where: str) -> None:
    for role in ("camera", "projector"):
        one, true = getattr(rig, role), getattr(own, role)
        if (one.width, one.height) != (true.width, true.height):
            expected = f"a {role} of {true.width} x {true.height} px, as the scene's"
            raise InputError(where, expected, f"{one.width} x {one.height} px")
