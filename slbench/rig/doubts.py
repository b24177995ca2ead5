"""Doubts about a rig: values that can be used and were probably written in another unit.

Each function returns a sentence for :func:`slbench.core.errors.warn_user`, or None.  The bounds lie
where no device is: a doubt about a sensible rig is worse than none.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slbench.core.show.display import length
from slbench.rig.axes import closest_axes
from slbench.rig.device import Camera, Device
from slbench.rig.optics.distortion import fold_radius
from slbench.rig.rig import Pair, Rig

#: Pitches of sensors and panels, µm, with room: from phones' cameras to thermal ones and LED walls
#: behind lenses.
_PITCHES_UM = (0.4, 100.0)
#: Below, a pixel is a small part of a wavelength.
_NO_PITCH_UM = 0.1
#: Above, pixels are large for anything behind a lens; then the field or the lens tells.
_LARGE_PITCH_UM = 400.0
#: Half the field over the distance: beyond, no lens maps a plane to a plane (168 degrees).
_WIDEST = 10.0
#: Principal distance, mm, that no lens in front of a panel has.
_LONGEST_MM = 2000.0
#: Baselines, mm: devices nearer than the first cannot stand beside each other; where their axes
#: cross right before the lenses the second is as telling.  Beyond the third there is another unit.
_NO_BASELINE_MM, _SMALL_BASELINE_MM, _LONG_BASELINE_MM = 0.5, 2.0, 2e4
#: Where axes cross so near, no object has room, mm.
_NO_ROOM_MM = 5.0
#: Baseline, mm, that is no slip but devices in one place (coaxial ones).
_NONE_MM = 2e-3
#: Focal lengths by which lenses are sold, mm.
_CATALOGUE_MM = (
    *(3.5, 4.0, 4.5, 5.0, 6.0, 8.0, 8.5, 9.0, 10.0, 12.0, 12.5, 16.0, 17.0, 18.0, 20.0, 23.0),
    *(24.0, 25.0, 28.0, 30.0, 35.0, 40.0, 50.0, 55.0, 60.0, 75.0, 80.0, 85.0, 100.0, 105.0),
)
#: Least relative difference of principal distance and focal length that is worth a word: more than
#: the tolerance of focal lengths, some 3 %.
_LEAST_EXTENSION = 0.05
#: Error of a principal point, in sizes of the image, that still tells another resolution.
_NEAR = 0.06
#: Blur, px, beyond which it is questioned: ordinary projectors have one or two.
_MOST_BLUR_PX = 20.0
#: Wavelengths of light that lenses take, nm.
_WAVELENGTHS_NM = (100.0, 20_000.0)
#: Focus over the distance of the volume, of lenses that see something.
_LIKE = (0.3, 3.0)
_LEAST_DISTANCE_MM = 10.0
#: Places along each side of a panel that are asked whether they see anything.
_SAMPLED = 33


def pitch_doubt(device: Device) -> str | None:
    """Question a pixel pitch that is a thousand times off: given in mm, or in nm."""
    for size_px, pitch in zip((device.width, device.height), device.pitch_mm, strict=True):
        um = 1e3 * pitch
        if um < _NO_PITCH_UM and _fits(1e3 * um, _PITCHES_UM):
            less = f"{um:.3g} µm is less than a wavelength of light"
            return f"{less}; as {um:.3g} mm it would be {1e3 * um:.3g} µm"
        focal = device.lens.focal_length_mm
        wide = device.lens.kind == "perspective" and size_px * pitch / (2 * focal) > _WIDEST
        if um >= _LARGE_PITCH_UM and _fits(um / 1e3, _PITCHES_UM) and (wide or focal > _LONGEST_MM):
            width = f"makes a panel {length(size_px * pitch)} long"
            return f"{um:.6g} µm {width}; as {um:.6g} nm it would be {um / 1e3:.3g} µm"
    return None


def baseline_doubt(rig: Rig) -> str | None:
    """Question a distance between camera and projector in metres, or in µm."""
    camera, projector = rig.camera.pose, rig.projector.pose
    apart = camera.position - projector.position
    baseline = float(np.linalg.norm(apart))
    said = f"camera and projector are {length(baseline)} apart"
    if baseline > _LONG_BASELINE_MM:
        return f"{said}; in µm it would be {length(baseline / 1e3)}"
    near = baseline < _SMALL_BASELINE_MM and _crossing_mm(rig) < _NO_ROOM_MM
    if _NONE_MM < baseline < _NO_BASELINE_MM or (baseline > _NONE_MM and near):
        return f"{said}; in metres it would be {length(1e3 * baseline)}"
    return None


def _crossing_mm(rig: Rig) -> float:
    """Return how far before the lenses the axes come closest; infinite where they do not."""
    closest = closest_axes(rig.camera.pose, rig.projector.pose)
    return float("inf") if closest is None else max(closest.camera_mm, closest.projector_mm)


def principal_point_doubt(camera: Camera) -> str | None:
    """Question a principal point that is the centre of frames of another resolution.

    A projector's lens is often shifted, and parts of a sensor are read; both put the principal
    point anywhere, but seldom there.
    """
    size = np.array([camera.width, camera.height], dtype=np.float64)
    relative = (np.array(camera.centre) + 0.5) / size
    said = (
        f"({camera.centre[0]:.4g}, {camera.centre[1]:.4g}) in {camera.width} x {camera.height} px"
    )
    if not any(camera.centre):
        return f"{said} is the corner: the centre is at half the size"
    for factor in (2.0, 3.0, 4.0, 8.0):
        for scale, word in ((factor, "larger"), (1.0 / factor, "smaller")):
            if np.all(np.abs(relative - scale / 2) < _NEAR * min(scale, 1.0)):
                found = f"is the centre of frames {factor:g} times {word}"
                return f"{said} {found}: a calibration at another resolution?"
    return None


def focal_length_doubt(focal_length_mm: float, focus_distance_mm: float) -> str | None:
    """Question a principal distance that is the focal length of a lens by its catalogue.

    A thin lens of focal length f in focus at the distance d has the principal distance
    f d / (d - f), which is what a calibration finds and what a scene states.  A catalogue's value
    is recognised where both differ by 5 % or more, below a magnification of one.
    """
    f, d = focal_length_mm, focus_distance_mm
    if f not in _CATALOGUE_MM or not 2 * f < d < np.inf or f / (d - f) < _LEAST_EXTENSION:
        return None
    return (
        f"{f:g} mm is taken as principal distance; a lens of {f:g} mm focal length in focus at "
        f"{length(d)} has {f * d / (d - f):.4g} mm"
    )


def fold_doubt(device: Device) -> str | None:
    """Question a distortion that folds within the panel's own field."""
    across = [np.linspace(-0.5, n - 0.5, _SAMPLED) for n in (device.width, device.height)]
    pixels = np.stack(np.meshgrid(*across), axis=-1)
    lost = float(np.mean(np.isnan(device.normalise(pixels)[..., 0])))
    if lost == 0.0:
        return None
    fold = fold_radius(device.distortion)
    return (
        f"the lens's model folds at {fold:.3g} of the distance from the axis, so that "
        f"{max(1, round(100 * lost))} % of the pixels see nothing: a calibration whose points did "
        "not reach the corners?"
    )


def wavelength_doubt(device: Device) -> str | None:
    """Question a wavelength in another unit, or one that no aperture diffracts."""
    nm = device.lens.wavelength_nm
    if nm == 0.0:
        return None
    for unit, factor in (("µm", 1e3), ("mm", 1e6), ("m", 1e9), ("pm", 1e-3)):
        if not _fits(nm, _WAVELENGTHS_NM) and _fits(nm * factor, _WAVELENGTHS_NM):
            return f"{nm:.4g} nm is no light; in {unit} it would be {nm * factor:.4g} nm"
    if device.lens.aperture_radius_mm == 0.0:
        return f"{nm:.4g} nm have no effect: a pinhole (no f_number) does not diffract here"
    return None


def focus_doubt(device: Device) -> str | None:
    """Question a focus a thousand times as near or as far as the middle of the volume."""
    focus = device.lens.focus_distance_mm
    if not np.isfinite(focus) or device.lens.aperture_radius_mm == 0.0:
        return None
    distance = -float(device.pose.position @ device.pose.rotation[:, 2])
    for unit, factor in (("metres", 1e3), ("µm", 1e-3)):
        # Where the world is a device's own frame, its origin is no volume.
        if distance > _LEAST_DISTANCE_MM and _fits(focus * factor / distance, _LIKE):
            return (
                f"{focus:.4g} mm, where the volume is {length(distance)} away; "
                f"in {unit} it would be {length(focus * factor)}"
            )
    return None


def blur_doubt(device: Device) -> str | None:
    """Question a blur that leaves nothing of ordinary fringes: another unit, perhaps."""
    if device.blur_px <= _MOST_BLUR_PX:
        return None
    finest = 4.0 * device.blur_px  # 0.3 of the contrast
    micrometres = 1e-3 * device.blur_px / device.pitch_mm[0]
    return (
        f"a blur of {device.blur_px:.4g} px (standard deviation) leaves little of fringes finer "
        f"than {finest:.3g} px; {device.blur_px:.4g} µm would be {micrometres:.3g} px"
    )


def rig_doubts(rig: Rig) -> Iterator[tuple[str, str]]:
    """Return what is odd about a rig: (what, sentence), once of each device and pair."""
    if len(rig.pairs) == 1:
        yield from _pair_doubts(rig, Pair("the camera", "the projector"), "")
        return
    pairs = ((rig.pair(pair), pair, f" of {' and '.join(pair)}") for pair in rig.pairs)
    yield from dict.fromkeys(one for pair in pairs for one in _pair_doubts(*pair))


def _pair_doubts(rig: Rig, names: Pair, both: str) -> Iterator[tuple[str, str]]:
    """Return what is odd about a camera and a projector, by what each and both are called."""
    for name, device in zip(names, (rig.camera, rig.projector), strict=True):
        if doubt := pitch_doubt(device):
            yield f"pitch_um of {name}", doubt
        if doubt := wavelength_doubt(device):
            yield f"wavelength_nm of {name}", doubt
        if (doubt := focus_doubt(device)) and not baseline_doubt(rig):
            yield f"focus_distance_mm of {name}", doubt
        if doubt := blur_doubt(device):
            yield f"blur_px of {name}", doubt
        if any(device.distortion) and (doubt := fold_doubt(device)):
            yield f"distortion of {name}", doubt
    if doubt := principal_point_doubt(rig.camera):
        yield f"principal point of {names.camera}", doubt
    if doubt := baseline_doubt(rig):
        yield f"baseline{both}", doubt


def _fits(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]
