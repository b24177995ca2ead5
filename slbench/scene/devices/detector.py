"""``[detector]`` of a scene file: the detector's keys, and what EMVA 1288 sheets state for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import FINITE, Interval
from slbench.core.validation.values import validated
from slbench.detector.base import DEFAULT, DetectorModel, detector_of
from slbench.detector.emva1288 import Detector
from slbench.scene.devices import datasheet

#: Ratios of cameras, dB; 120 is a million.
_Decibels = Annotated[float, FINITE, Interval(ge=1.0, le=120.0)]


class SheetKeys(Parameters):
    """Keys of an EMVA 1288 sheet that stand for others of the detector."""

    snr_max_db: _Decibels | None = None
    dynamic_range_db: _Decibels | None = None


def read_detector(table: Mapping[str, Any], where: str) -> DetectorModel:
    """Return the detector of a table ``[detector]``.

    Raises
    ------
    InputError
        Naming the key at fault, and for a data sheet's key beside the one that it stands for.
    """
    if table.get("kind", DEFAULT) != DEFAULT:
        return detector_of(table, where)
    stated = {key: table[key] for key in SheetKeys.model_fields if key in table}
    sheet = validated(SheetKeys, stated, where)
    values = {key: value for key, value in table.items() if key not in stated}
    for key, other in (("snr_max_db", "full_well_e"), ("dynamic_range_db", "read_noise_e")):
        if key in stated and other in values:
            raise InputError(f"{where}.{key}", f"{other} or {key}, not both", "both")
    if sheet.snr_max_db is not None:
        values["full_well_e"] = datasheet.saturation_e(sheet.snr_max_db)
    if sheet.dynamic_range_db is not None:
        well = validated(Detector, {k: v for k, v in values.items() if k == "full_well_e"}, where)
        try:
            noise = datasheet.dark_noise_e(well.full_well_e, sheet.dynamic_range_db)
        except InputError as error:
            raise InputError(f"{where}.{error.where}", error.expected, error.got) from None
        values["read_noise_e"] = noise
    return detector_of(values, where)
