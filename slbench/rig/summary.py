"""A rig in numbers: what one looks at before one believes a calibration."""

from __future__ import annotations

from typing import Any

import numpy as np

from slbench.core.show.display import length, numbers
from slbench.core.show.document import Table
from slbench.rig.axes import closest_axes
from slbench.rig.device import Device
from slbench.rig.doubts import rig_doubts
from slbench.rig.rig import Rig


def summary_of(rig: Rig) -> dict[str, Any]:
    """Return a rig of one camera and one projector in numbers.

    Returns
    -------
    dict
        ``camera`` and ``projector``: ``name``, ``size_px``, ``focal_px`` (along u and v),
        ``focal_mm``, ``pitch_um``, ``principal_point_px``, ``field_deg`` (across and down, from
        edge to edge through the panel's place nearest to the principal point), of a telecentric
        lens ``field_mm`` (likewise) and ``pixel_um`` (on the object, along u and v),
        ``distortion``,
        ``aperture_radius_mm``, ``focus_distance_mm``, ``position_mm``; ``baseline_mm``; ``axes``:
        ``angle_deg`` between them, and where they come closest before the lenses (else None),
        ``camera_mm``, ``projector_mm``, ``gap_mm``, ``middle_mm``; ``volume_mm``; ``doubts``: list
        of str.
    """
    camera, projector = rig.camera, rig.projector
    one, two = (device.pose.rotation[:, 2] for device in (camera, projector))
    sine = np.linalg.norm(np.cross(one, two))
    closest = closest_axes(camera.pose, projector.pose)
    crossing = None
    if closest is not None:
        crossing = {
            "camera_mm": closest.camera_mm,
            "projector_mm": closest.projector_mm,
            "gap_mm": closest.gap_mm,
            "middle_mm": closest.middle.tolist(),
        }
    return {
        "camera": {"name": rig.only.camera} | _device(camera),
        "projector": {"name": rig.only.projector} | _device(projector),
        "baseline_mm": float(np.linalg.norm(rig.baseline)),
        "axes": {
            "angle_deg": float(np.rad2deg(np.arctan2(sine, one @ two))),
            "closest": crossing,
        },
        "volume_mm": list(rig.volume_mm),
        "doubts": [f"{what}: {doubt}" for what, doubt in rig_doubts(rig)],
    }


def _device(device: Device) -> dict[str, Any]:
    matrix, lens = device.matrix, device.lens
    right, bottom = device.width - 0.5, device.height - 0.5
    # A shifted lens has its axis beside the panel.
    across, down = np.clip(device.centre, -0.5, (right, bottom))
    ends = np.array([[-0.5, down], [right, down], [across, -0.5], [across, bottom]])
    origins, directions = device.unproject(ends)
    field: dict[str, Any] = {"field_deg": _angles(directions)}
    if lens.kind == "telecentric":
        field["field_mm"] = np.linalg.norm(origins[1::2] - origins[::2], axis=1).tolist()
        field["pixel_um"] = (1e3 * lens.focus_distance_mm / np.diag(matrix)[:2]).tolist()
    return {
        "size_px": [device.width, device.height],
        "focal_px": [float(matrix[0, 0]), float(matrix[1, 1])],
        "focal_mm": lens.focal_length_mm,
        "pitch_um": [1e3 * pitch for pitch in device.pitch_mm],
        "principal_point_px": list(device.centre),
        **field,
        "distortion": device.opencv_distortion.tolist(),
        "aperture_radius_mm": lens.aperture_radius_mm,
        "focus_distance_mm": lens.focus_distance_mm,
        "position_mm": device.pose.position.tolist(),
    }


def _angles(rays: np.ndarray) -> list[float]:
    """Return the angles between the first two rays and between the last two, degrees."""
    return [
        float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, two)), one @ two)))
        for one, two in (rays[:2], rays[2:])
    ]


def _field(device: dict[str, Any]) -> str:
    if "field_mm" in device:
        return f"{numbers(device['field_mm'], ' x ')} mm, telecentric"
    return f"{numbers(device['field_deg'], ' x ')}°"


def _focus(device: dict[str, Any]) -> str:
    if not device["aperture_radius_mm"]:
        return "everywhere"
    focus = device["focus_distance_mm"]
    return length(focus) if np.isfinite(focus) else "infinity"


def summary_table(summary: dict[str, Any]) -> Table:
    """Return what :func:`summary_of` gives as a table, a column a device."""
    devices = (summary["camera"], summary["projector"])
    lines = {
        "size (px)": [numbers(one["size_px"], " x ") for one in devices],
        "focal length (px)": [numbers(one["focal_px"]) for one in devices],
        "focal length at the pitch": [
            f"{length(one['focal_mm'])} at {numbers(one['pitch_um'], ' x ')} µm" for one in devices
        ],
        "principal point (px)": [numbers(one["principal_point_px"]) for one in devices],
        "field of view": [_field(one) for one in devices],
        "distortion": [numbers(one["distortion"]) for one in devices],
        "aperture radius": [
            length(one["aperture_radius_mm"]) if one["aperture_radius_mm"] else "pinhole"
            for one in devices
        ],
        "in focus at": [_focus(one) for one in devices],
        "position (mm)": [numbers(one["position_mm"]) for one in devices],
    }
    if any("pixel_um" in one for one in devices):
        lines["pixel on the object"] = [
            f"{numbers(one['pixel_um'], ' x ')} µm" if "pixel_um" in one else "" for one in devices
        ]
    closest = summary["axes"]["closest"]
    if closest is not None:
        lines["axes come closest at"] = [
            length(closest[f"{role}_mm"]) for role in ("camera", "projector")
        ]
    columns = ("", *(one["name"] for one in devices))
    return Table("", columns, tuple((name, *texts) for name, texts in lines.items()))


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """Return what is of both devices, in words."""
    closest = summary["axes"]["closest"]
    where = "axes do not meet before the lenses"
    if closest is not None:
        where = f"axes {length(closest['gap_mm'])} apart at ({numbers(closest['middle_mm'])}) mm"
    return [
        f"baseline {length(summary['baseline_mm'])}, "
        f"angle between the axes {summary['axes']['angle_deg']:.2f}°, {where}",
        f"volume {numbers(summary['volume_mm'], ' x ')} mm",
    ]
