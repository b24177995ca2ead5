"""What is known of a scanner's devices, as tables of its twin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from slbench.capture.capture import Capture
from slbench.capture.noise import noise_of
from slbench.core.errors import InputError
from slbench.scene.devices.detector import SheetKeys
from slbench.scene.devices.optics import CameraOptics, ProjectorOptics
from slbench.scene.file import read_merged
from slbench.scene.tables import CameraBeside, ProjectorBeside

#: Bits of the twin's frames where photographs are floats.
_FLOAT_BITS = 16


def hardware_tables(path: str | Path | None, capture: Capture) -> dict[str, dict[str, Any]]:
    """Return the tables of a hardware file, with the capture's noise where it has none.

    Parameters
    ----------
    path : path or None
    capture : Capture

    Returns
    -------
    dict
        ``camera``, ``projector``, ``detector`` and ``exposure``.

    Raises
    ------
    InputError
        For another camera's resolution or bit depth.
    """
    read = {} if path is None else read_merged(Path(path))
    tables = {name: dict(read.get(name, {})) for name in ("camera", "projector", "detector")}
    tables["exposure"] = {
        key: value for key, value in read.get("exposure", {}).items() if key == "vibration_px"
    }
    sizes = {"camera": capture.frames.shape[1:][::-1], "projector": capture.sequence.panel}
    of_the_rig = {
        "camera": set(CameraOptics.model_fields) - set(CameraBeside.model_fields),
        "projector": set(ProjectorOptics.model_fields) - set(ProjectorBeside.model_fields),
    }
    for role, keys in of_the_rig.items():
        stated = tables[role].get("resolution_px")
        if stated is not None and tuple(stated) != tuple(sizes[role]):
            expected = f"{list(sizes[role])}, as the capture has"
            raise InputError(f"{path}: {role}.resolution_px", expected, stated)
        for key in keys:
            tables[role].pop(key, None)
    straight, projector = capture.response, tables["projector"]
    if straight is not None and not {"gamma", "response"} & set(projector):
        curve = straight.curve
        projector |= {"gamma": straight.gamma} if curve is None else {"response": curve}
    detector = tables["detector"]
    depth = capture.bit_depth or _FLOAT_BITS
    if detector.setdefault("bit_depth", depth) != depth:
        expected = f"{capture.bit_depth}, as the capture has"
        raise InputError(f"{path}: detector.bit_depth", expected, detector["bit_depth"])
    if not set(detector) & {"gain_e_per_dn", "full_well_e", *SheetKeys.model_fields}:
        phase = capture.decode(keep_evidence=True)
        noise, kind = noise_of(capture, phase)
        if kind == "lower bound" or noise.gain_dn_per_e == 0.0:
            raise InputError(
                "twin",
                "a camera whose noise is known: --hardware, [noise] in capture.toml, or fringes of "
                "four shifts or more",
                "none",
            )
        gain = 1.0 / noise.gain_dn_per_e
        detector |= {"gain_e_per_dn": gain, "read_noise_e": noise.read_dn * gain}
        detector.setdefault("offset_dn", max(noise.offset_dn, 0.0))
    if "gain_e_per_dn" in detector and not set(detector) & {"full_well_e", "snr_max_db"}:
        top = min(capture.top_dn, 2.0 ** detector["bit_depth"] - 1.0)
        black = detector.get("offset_dn", 0.0)
        detector["full_well_e"] = (top - black) * detector["gain_e_per_dn"]
    detector.setdefault("dark_current_e_per_s", 0.0)
    return tables
