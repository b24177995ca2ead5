"""What a calibration by boards found, in tables and sentences."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from slbench.calibration.bundle.adjustment.field import DistortionField
from slbench.calibration.bundle.agreement import Agreement
from slbench.calibration.bundle.result import BoardCalibration
from slbench.core.errors import InputError
from slbench.core.show.document import Cell, Table
from slbench.rig.parameters import ROLES

#: Rows of the table of points left out.
_LISTED = 50
#: Factor of the deviations beyond which a device's model is in doubt, and the pose factor.
_MODEL_DOUBT, _POSE_DOUBT = 3.0, 2.0
_WORDS = {"camera": "detected points", "projector": "phases"}


def pose_table(found: BoardCalibration, refused: Mapping[str, InputError]) -> Table:
    """Return the poses with their points and residuals, and those that were refused."""
    devices = range(len(found.roles))
    blank = (None,) * (2 + len(devices))
    rows: list[tuple[Cell, ...]] = [
        (
            view.name,
            len(view),
            int(np.count_nonzero(~mask)),
            *(found.rms_px(device, k) for device in devices),
        )
        for k, (view, mask) in enumerate(zip(found.views, found.kept, strict=True))
    ]
    rows += [(f"{name} (left out)", *blank) for name in found.strangers]
    rows += [(f"{name} (refused)", *blank) for name in refused]
    columns = ("pose", "points", "left out", *(f"{role} RMS / px" for role in found.roles))
    return Table("Poses", columns, tuple(rows), "Root mean square distances, seen to projected.")


def parameter_table(found: BoardCalibration) -> Table:
    """Return every parameter's value and deviation."""
    fixed = set(found.fixed)
    rows: list[tuple[Cell, ...]] = []
    for name, (value, std) in found.parameters.items():
        if std == 0.0 and value == 0.0 and name not in fixed:
            continue
        how = "fixed" if name in fixed else f"{std:.3g}"
        rows.append((name, f"{value:.7g}", how))
    note = ""
    if found.roles == ROLES:
        length, std = found.baseline_mm
        rows.append(("baseline / mm", f"{length:.7g}", f"{std:.3g}"))
        note = "The projector's turn (rotation vector) and place are in the camera's frame."
    if found.pixel_um is not None:
        size, std = found.pixel_um
        rows.append(("camera pixel on the object / µm", f"{size:.7g}", f"{std:.3g}"))
        note += (
            " A telecentric camera's centre and its place along its axis are conventions; the "
            "baseline is from its axis."
        )
    return Table("Parameters", ("parameter", "value", "deviation"), tuple(rows), note)


def left_out_table(found: BoardCalibration) -> Table:
    """Return the points that were left out."""
    rows: list[tuple[Cell, ...]] = [
        (name, *(float(x) for off in both[: len(found.roles)] for x in off))
        for name, *both in found.left_out[:_LISTED]
    ]
    count = len(found.left_out)
    words = ("camera", "panel")[: len(found.roles)]
    columns = ("point", *(f"{word} {axis} / px" for word in words for axis in "uv"))
    note = "What they are off; column and row are the board's."
    if count > _LISTED:
        note += f" The first {_LISTED} of {count}."
    return Table("Points left out", columns, tuple(rows), note)


def sentences(found: BoardCalibration) -> list[str]:
    """Say how well the model fits, and what points it predicts."""
    points = sum(int(mask.sum()) for mask in found.kept)
    both = found.roles == ROLES
    text = (
        f"{points} points in {len(found.views)} poses: RMS {found.rms_px(0):.3g} px in the camera"
    )
    told = [text + (f", {found.rms_px(1):.3g} px on the panel" if both else "")]
    if found.left_out:
        names = ", ".join(name for name, _, _ in found.left_out[:3])
        more = ", ..." if len(found.left_out) > 3 else ""
        told.append(f"{len(found.left_out)} points left out: {names}{more}")
    _, *deviations = found.predicted if both else (None, np.empty((0, 3)))
    seen = np.isfinite(deviations[0]).all(axis=1)
    if seen.any():
        place, shape = (
            "x {:.3g}, y {:.3g}, z {:.3g} µm".format(*1e3 * np.median(one[seen], axis=0))
            for one in deviations
        )
        told.append(
            f"predicted deviation of points by the calibration (axis {found.axis}, median through "
            f"the boards' volume): {place}; of their shape, after a rigid motion: {shape}"
        )
    told += [_distortion(role, field) for role, field in found.known.distortion.items()]
    for role, square in found.known.chi_square.items():
        ratio = square**0.5
        text = f"{_WORDS[role]} scatter {ratio:.3g} times as much as their noise predicts"
        told.append(text + _cause(ratio, found.known.pose_factor))
    if found.known.pose_factor > _POSE_DOUBT:
        ratio = found.known.pose_factor**0.5
        told.append(
            f"residuals of a pose are alike: whole poses scatter {ratio:.2g} times as much as "
            "independent points would; deviations are widened"
        )
    return told


def _distortion(role: str, field: DistortionField) -> str:
    """Say how well a device's distortion is known, and which coefficients are not each."""
    text = (
        f"distortion of the {role} is known to {field.seen_px:.2g} px where points are, and to "
        f"{field.picture_px:.2g} px in the picture's corners"
    )
    if field.together:
        *most, last = field.together
        names = f"{', '.join(most)} and {last}"
        text += f"; {names} are only told together: their own deviations say little"
    return text


def _cause(ratio: float, pose_factor: float) -> str:
    """Say what a ratio of deviations hints at."""
    if ratio < _MODEL_DOUBT:
        return ""
    if pose_factor > _POSE_DOUBT:
        return ": a wider lens model, or a board that is not flat? (deviations are scaled)"
    return ": the pictures' own limits, as residuals are not alike (deviations are scaled)"


def doubts(found: BoardCalibration) -> dict[str, str]:
    """Return what poses do not tell, and views that are left out, by what it is about."""
    told = dict.fromkeys(found.strangers, "most of its points do not fit the others: left out")
    if not found.converged:
        what = "add poses" if found.agreement else "fix what the poses hardly tell (--fix)"
        told["adjustment"] = f"did not come to rest: {what}"
    told |= _disagreement(found.agreement)
    alike: dict[str, list[str]] = {}
    for name, why in found.known.undetermined.items():
        alike.setdefault(why, []).append(name)
    for why, names in alike.items():
        fix = " ".join(f"--fix {name}" for name in names)
        told[", ".join(names)] = why if found.agreement else f"{why} ({fix})"
    return told


def _disagreement(agreement: Mapping[str, Agreement]) -> dict[str, str]:
    """Say that views do not fit devices as stated, which of them, and why that may be."""
    wrong = {what: one for what, one in agreement.items() if one.doubtful}
    if not wrong:
        return {}
    blamed = [role for role in ROLES if role in wrong]
    one = wrong[blamed[0]] if len(blamed) == 1 else next(iter(wrong.values()))
    exact = ", or less certain than exact, as no covariance stands beside it" if one.exact else ""
    why = (
        f"boards do not fit it as stated (chi-square {one.chi_square:.3g}, {one.most:.3g} at most "
        f"is likely): focused again or zoomed, another lens, another part of the sensor{exact}? "
        "Calibrate it again"
    )
    return {blamed[0] if len(blamed) == 1 else "camera or projector": why}
