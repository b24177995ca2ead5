"""Frames: exposed from light transport, or read from a folder of photographs.

``transport x patterns x detector -> frames``: every frame is a sparse product and a noise
draw.  A :class:`Capture` holds the frames and what was projected; a folder holds them as PNG
beside ``capture.toml``, and the same manifest describes real photographs::

    format = 1
    bit_depth = 8
    frames = ["frames/000.png", "frames/001.png", ...]   # in the order of the patterns
    rig = "rig.yaml"                                     # optional, to triangulate

    [patterns]
    panel = [640, 480]                                   # width and height, px
    parts = [
        { kind = "fringes", count = 1, shifts = 3, axis = "u" },
        { kind = "fringes", count = 10, shifts = 3, axis = "u" },
    ]

    [noise]                                              # optional: predicted deviations
    read_dn = 0.19
    gain_dn_per_e = 0.016
    offset_dn = 2.0
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import read_grey, read_toml, write_png, write_toml
from slbench.detector.emva1288 import (
    BIT_DEPTHS,
    auto_exposure_scale,
    expose,
    noise_model,
    photons_from_irradiance,
)
from slbench.patterns import (
    MIN_MODULATION_DN,
    Axis,
    NoiseModel,
    PatternSequence,
    PhaseMap,
    decode,
    panel_response,
)
from slbench.rig import Rig
from slbench.rig.opencv import read_rig, write_rig
from slbench.scene.model import Scene
from slbench.simulate.transport import LightTransport

MANIFEST = "capture.toml"
_FORMAT = 1
#: Memory for noise-free frames at a time.
_FLOOR_BYTES = 1 << 27
_KEYS = {
    "format",
    "bit_depth",
    "saturation_dn",
    "min_modulation_dn",
    "frames",
    "rig",
    "patterns",
    "noise",
    "exposure_ms",
}

#: Exposure time that the dark signal is computed with where the light's power is unknown (a
#: pinhole camera, automatic exposure).
NOMINAL_EXPOSURE_S = 0.01


@dataclass(frozen=True, eq=False)
class Capture:
    """The frames of one scan and what was projected.

    Parameters
    ----------
    frames : (N, V, U) uint8 or uint16
        Digital numbers, one frame a pattern.
    sequence : PatternSequence
        N frames.
    bit_depth : int
        Bits of a digital number.
    noise : NoiseModel or None
        Temporal noise, for predicted deviations; None where it is not known.
    rig : Rig or None
        Geometry, where it is known.
    exposure_s : float or None
    saturation_dn : int or None
        Digital number at and above which a pixel is saturated; None is the top of the range.
    min_modulation_dn : float or None
        Least modulation of a pixel that is measured; None is the decoder's own limit.
    """

    frames: NDArray[Any]
    sequence: PatternSequence
    bit_depth: int = 8
    noise: NoiseModel | None = None
    rig: Rig | None = None
    exposure_s: float | None = None
    saturation_dn: int | None = None
    min_modulation_dn: float | None = None

    def __post_init__(self) -> None:
        frames = self.frames
        if frames.ndim != 3 or frames.dtype not in (np.uint8, np.uint16) or frames.size == 0:
            raise InputError(
                "capture frames", "(N, V, U) uint8 or uint16", f"{frames.shape} {frames.dtype}"
            )
        if len(frames) != self.sequence.n_frames:
            raise InputError(
                "capture frames",
                f"{self.sequence.n_frames}, as many as patterns ({self.sequence.name})",
                len(frames),
            )
        if type(self.bit_depth) is not int or self.bit_depth not in BIT_DEPTHS:
            raise InputError("bit_depth", f"one of {BIT_DEPTHS}", repr(self.bit_depth))
        top = 2**self.bit_depth - 1
        level = self.saturation_dn
        if level is not None and (type(level) is not int or not 1 <= level <= top):
            raise InputError("saturation_dn", f"a whole number from 1 to {top}", repr(level))
        time = self.exposure_s
        if time is not None and not 0 < time < np.inf:
            raise InputError("exposure", "a positive time", f"{time} s")
        least = self.min_modulation_dn
        if least is not None and (type(least) not in (int, float) or not 0 <= least <= top):
            raise InputError("min_modulation_dn", f"a number from 0 to {top}", repr(least))
        if frames.dtype.itemsize * 8 < self.bit_depth:
            raise InputError("capture frames", f"{self.bit_depth} bit frames", frames.dtype)
        if self.rig is not None:
            _check_sizes(self.rig, frames.shape, self.sequence.panel)

    @property
    def least_modulation_dn(self) -> float:
        """Least modulation of a pixel that is measured: `min_modulation_dn` or the default."""
        own = self.min_modulation_dn
        return MIN_MODULATION_DN if own is None else own

    def decode(self, min_modulation: float | None = None, **options: Any) -> PhaseMap:
        """Decode the frames.

        Parameters
        ----------
        min_modulation : float, optional
            DN; :attr:`least_modulation_dn` by default.
        **options
            As for :func:`slbench.patterns.decode`.
        """
        return decode(
            self.frames,
            self.sequence,
            noise=self.noise,
            saturation=self.saturation_dn or 2**self.bit_depth - 1,
            min_modulation=self.least_modulation_dn if min_modulation is None else min_modulation,
            **options,
        )

    def save(self, folder: str | Path) -> None:
        """Write frames, manifest and rig to `folder`; the manifest comes last."""
        root = Path(folder)
        (root / "frames").mkdir(parents=True, exist_ok=True)
        names = [f"frames/{k:03d}.png" for k in range(len(self.frames))]
        for name, frame in zip(names, self.frames, strict=True):
            write_png(root / name, frame)
        manifest: dict[str, Any] = {
            "format": _FORMAT,
            "bit_depth": self.bit_depth,
            "frames": names,
            "patterns": self.sequence.to_dict(),
        }
        if self.saturation_dn is not None:
            manifest["saturation_dn"] = self.saturation_dn
        if self.min_modulation_dn is not None:
            manifest["min_modulation_dn"] = self.min_modulation_dn
        if self.exposure_s is not None:
            manifest["exposure_ms"] = self.exposure_s * 1e3
        if self.noise is not None:
            manifest["noise"] = asdict(self.noise)
        if self.rig is not None:
            write_rig(root / "rig.yaml", self.rig)
            manifest["rig"] = "rig.yaml"
        write_toml(root / MANIFEST, manifest)

    @classmethod
    def load(cls, folder: str | Path) -> Capture:
        """Read a folder with a manifest: what :meth:`save` wrote, or real photographs.

        Raises
        ------
        InputError
            Naming the file and key at fault: a missing manifest or frame, frames of
            different sizes, a path that leaves the folder.
        """
        root = Path(folder)
        path = root if root.suffix == ".toml" else root / MANIFEST
        manifest = read_toml(path)
        for key in manifest:
            if key not in _KEYS:
                raise InputError(f"{path}: {key}", f"one of {sorted(_KEYS)}", "an unknown key")
        for key in ("frames", "patterns"):
            if key not in manifest:
                raise InputError(f"{path}: {key}", "this key to be present", "nothing")
        if manifest.get("format", _FORMAT) != _FORMAT:
            raise InputError(f"{path}: format", str(_FORMAT), manifest["format"])
        try:
            sequence = PatternSequence.from_dict(manifest["patterns"])
            noise = _noise(manifest["noise"]) if "noise" in manifest else None
            frames = _read_frames(path.parent, manifest["frames"])
            rig = None
            if "rig" in manifest:
                rig = read_rig(resources.inside(path.parent, manifest["rig"]))
            bits = manifest.get("bit_depth", 8 * frames.dtype.itemsize)
            exposure = manifest.get("exposure_ms")
            if exposure is not None and type(exposure) not in (int, float):
                raise InputError("exposure_ms", "a number", repr(exposure))
            time = None if exposure is None else float(exposure) * 1e-3
            saturation = manifest.get("saturation_dn")
            least = manifest.get("min_modulation_dn")
            return cls(frames, sequence, bits, noise, rig, time, saturation, least)
        except InputError as error:
            raise InputError(f"{path}: {error.where}", error.expected, error.got) from None


def _check_sizes(rig: Rig, frames: tuple[int, ...], panel: tuple[int, int]) -> None:
    camera, projector = rig.camera, rig.projector
    if frames[1:] != (camera.height, camera.width):
        raise InputError(
            "frames",
            f"the rig's {camera.width} x {camera.height} px",
            f"{frames[2]} x {frames[1]} px",
        )
    if panel != (projector.width, projector.height):
        raise InputError(
            "patterns.panel",
            f"the rig's {projector.width} x {projector.height} px",
            f"{panel[0]} x {panel[1]} px",
        )


def _noise(table: Any) -> NoiseModel:
    fields = {"read_dn", "gain_dn_per_e", "offset_dn", "step_dn"}
    if not isinstance(table, dict) or set(table) - fields:
        raise InputError("noise", f"a table with {sorted(fields)}", table)
    for key, value in table.items():
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            raise InputError(f"noise.{key}", "a number", repr(value))
    return NoiseModel(**table)


def _read_frames(folder: Path, names: Any) -> NDArray[Any]:
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise InputError("frames", "a list of image files", repr(names)[:60])
    frames: NDArray[Any] | None = None
    for k, name in enumerate(names):
        image = read_grey(resources.inside(folder, name))
        if frames is None:
            frames = np.empty((len(names), *image.shape), image.dtype)
        if image.shape != frames.shape[1:] or image.dtype != frames.dtype:
            raise InputError(
                name,
                f"{frames.shape[2]} x {frames.shape[1]} px {frames.dtype} as the first frame",
                f"{image.shape[1]} x {image.shape[0]} px {image.dtype}",
            )
        frames[k] = image
    assert frames is not None  # names is not empty
    return frames


def capture(
    scene: Scene,
    transport: LightTransport,
    *,
    seed: int = 0,
    noise: bool = True,
    light: tuple[float, float] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Capture:
    """Expose the frames of a scene's patterns.

    Parameters
    ----------
    scene : Scene
        Its sequence, projector, detector and exposure; the light comes from `transport`.
    transport : LightTransport
        With the marginals of the axes that the sequence codes.
    seed : int
        Of temporal noise and vibration.  The fixed pattern has the detector's own seed.
    noise : bool
        False: the expected frames, rounded once, without vibration.
    light : (float, float), optional
        Photons per unit radiance and exposure time, where another transport of the scene sets
        them (:func:`exposure`).
    on_progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    Capture
    """
    sequence = scene.sequence
    factor, exposure_s = exposure(scene, transport) if light is None else light
    shape = (sequence.n_frames, *transport.shape)
    dtype = np.uint8 if scene.detector.bit_depth == 8 else np.uint16
    frames = np.empty(shape, dtype)
    rng = np.random.default_rng([seed, 1])
    shake = np.random.default_rng([seed, 2]) if noise else None
    done = 0
    for indices, radiance in radiance_batches(scene, transport):
        if shake is not None and scene.exposure.vibration_px > 0:
            _vibrate(radiance, scene.exposure.vibration_px, shake)
        frames[indices] = expose(scene.detector, radiance, exposure_s, rng, noise, factor)
        done += len(indices)
        if on_progress:
            on_progress(done / len(frames))
    return Capture(
        frames,
        sequence,
        scene.detector.bit_depth,
        noise_model(scene.detector) if noise else NoiseModel(offset_dn=scene.detector.black_dn),
        scene.rig,
        exposure_s,
        scene.detector.saturation_dn,
    )


def radiance_batches(
    scene: Scene, transport: LightTransport
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.float32]]]:
    """Yield frame indices and their radiance images, a bounded number at a time."""
    projector = scene.rig.projector
    for axis in scene.sequence.axes or ("u",):
        indices, profiles = scene.sequence.profiles(axis)
        panel = panel_response(profiles, projector.bit_depth, projector.gamma)
        for part in transport.batches(len(indices)):
            yield indices[part], transport.relight(panel[part], axis)


def noise_free_coordinates(scene: Scene, transport: LightTransport) -> dict[Axis, NDArray]:
    """Decode the radiance itself, before the detector: the renderer's own error floor.

    What is left is not noise but geometry and sampling: the projector's square pixels, the
    pixel's footprint, and the Monte Carlo error of the light transport.

    Returns
    -------
    dict of axis to (V, U) float
        Panel coordinates, NaN where the modulation is below 1/200 of full white.
    """
    scale = np.float32(200.0 / max(float(np.percentile(transport.white(), 99.0)), 1e-30))
    height, width = transport.shape
    rows = max(1, _FLOOR_BYTES // (4 * width * scene.sequence.n_frames))
    bands: list[dict[Axis, NDArray]] = []
    for first in range(0, height, rows):
        band = transport.band(slice(first, first + rows))
        stack = np.empty((scene.sequence.n_frames, *band.shape), np.float32)
        for indices, radiance in radiance_batches(scene, band):
            stack[indices] = radiance * scale
        exact = NoiseModel(step_dn=0.0)
        bands.append(decode(stack, scene.sequence, noise=exact, min_modulation=1.0).coordinate)
    return {axis: np.concatenate([band[axis] for band in bands]) for axis in bands[0]}


def exposure(scene: Scene, transport: LightTransport) -> tuple[float, float]:
    """Return photons per unit radiance, and the exposure time in seconds.

    An automatic exposure scales the light until the fully lit picture reaches the wanted
    level; where the camera has an aperture this is expressed as an exposure time.

    Raises
    ------
    InputError
        For an absolute exposure through a pinhole, or where the projector lights nothing.
    """
    camera, detector, time = scene.rig.camera, scene.detector, scene.exposure.time_s
    per_second = None
    if time is not None or np.isfinite(camera.lens.f_number):
        # Photons per second and unit scene radiance; a pinhole has none, and says so.
        area = camera.pitch_mm[0] * camera.pitch_mm[1]
        irradiance = camera.etendue_mm2_sr / area
        photons = photons_from_irradiance(irradiance, 1.0, area, detector.wavelength_nm)
        per_second = float(photons)
        if time is not None:
            return per_second * time, time
    white = transport.white().astype(np.float64)
    lit = white > transport.ambient
    if not np.any(lit):
        raise InputError(f"scene {scene.name}", "an object that the projector lights", "none")
    factor = auto_exposure_scale(detector, white[lit], scene.exposure.white_level)
    return factor, (factor / per_second if per_second else NOMINAL_EXPOSURE_S)


def _vibrate(frames: NDArray[np.float32], sigma_px: float, rng: np.random.Generator) -> None:
    """Shift each frame by a random sub-pixel amount, in place (edges repeat)."""
    for frame, (du, dv) in zip(frames, rng.normal(0.0, sigma_px, (len(frames), 2)), strict=True):
        shifted = cv2.sepFilter2D(
            frame, -1, _shift_kernel(du), _shift_kernel(dv), borderType=cv2.BORDER_REPLICATE
        )
        # Interpolation overshoots at edges; light is not negative.
        np.maximum(shifted, 0.0, out=frame)


def _shift_kernel(shift: float) -> NDArray[np.float64]:
    """Return the correlation kernel that moves a line of pixels by `shift`.

    Lagrange interpolation through six samples: exact for polynomials of degree five, and good
    to 0.2 % of the shift for fringes of ten pixels.  (OpenCV's own bicubic warp moves even a
    ramp by half as much again where the shift is small.)
    """
    whole = int(np.floor(-shift))
    nodes = np.arange(-2, 4)
    differences = nodes[:, None] - nodes
    np.fill_diagonal(differences, 1)
    steps = np.broadcast_to(-shift - whole - nodes, differences.shape).copy()
    np.fill_diagonal(steps, 1.0)
    reach = abs(whole) + 3
    kernel = np.zeros(2 * reach + 1)
    kernel[nodes + whole + reach] = np.prod(steps / differences, axis=1)
    return kernel
