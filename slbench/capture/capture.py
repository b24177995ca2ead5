"""Frames and what was projected; a folder of photographs.

A :class:`Capture` holds the frames and what was projected; a folder holds them as PNG
beside ``capture.toml``, and the same manifest describes real photographs::

    format = 1
    bit_depth = 8
    frames = "frames/*.png"                              # in natural order, or a list of files
    rig = "rig.yaml"                                     # optional, to triangulate
    camera = "left"                                      # optional, where devices have names
    projector = "projector"

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

``exposures_ms = [2, 8, 32]`` at its top says that all frames were taken at each of several
exposures and are listed exposure by exposure; every pixel takes those of the longest at which it
is not saturated (:mod:`slbench.capture.exposures`).  ``response = 2.2`` is the projector's gamma,
``response = "curve.csv"`` its measured curve.  ``frame_period_ms = 10`` is the time from a picture
to the next, where something moved, and ``rolling_shutter_ms`` how much later the last row is
exposed than the first.  What ``frames`` may be is said in :mod:`slbench.capture.reading`.

``modules = ["my_codes.py"]``
at its top names Python files beside it that add pattern codes (:mod:`slbench.core.modules`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.capture.exposures import Bracket, Exposures, check_exposures
from slbench.capture.reading import allowed, frame_files, left_aligned, read_frames, shifted
from slbench.core.colour import BANDS, Band
from slbench.core.errors import InputError, located, warn_user
from slbench.core.io import OutputFolder, read_toml, write_png, write_tiff, write_toml
from slbench.core.modules import load_modules, save_modules
from slbench.core.show.display import block
from slbench.core.show.drawing import figure
from slbench.core.validation.types import (
    BitDepth,
    Grey,
    GreyLevel,
    MinLen,
    NotNegative,
    Positive,
    Word,
)
from slbench.core.validation.values import Value, validated
from slbench.patterns import (
    MIN_MODULATION_DN,
    NoiseModel,
    PatternSequence,
    PhaseMap,
    Response,
    decode,
    pattern_codes,
)
from slbench.patterns.crosstalk import amplified, unmixed
from slbench.rig import ALONE, Camera, Pair, Rig
from slbench.rig.motion import FrameTiming
from slbench.rig.opencv import read_rig, write_rig
from slbench.rig.optics.response import RESPONSE_FILE
from slbench.rig.parameters import ParameterCovariance, covariance_beside

MANIFEST = "capture.toml"
#: What a capture has at the top of its folder: modules may have added its codes.
CAPTURE_ENTRIES = (MANIFEST, "frames", "rig.yaml", RESPONSE_FILE, "*.py")
_FOLDER = OutputFolder("capture", CAPTURE_ENTRIES)
_FORMAT = 1
_TYPES = (np.uint8, np.uint16, np.float32, np.float64)


@dataclass(frozen=True, kw_only=True)
class CaptureTable(Value):
    """The keys of a ``capture.toml``."""

    frames: str | Annotated[tuple[str, ...], MinLen(1)]
    patterns: dict[str, Any]
    format: Literal[1] = 1
    modules: tuple[str, ...] = ()
    bit_depth: BitDepth | None = None
    saturation_dn: GreyLevel | None = None
    min_modulation_dn: Grey | None = None
    exposure_ms: Positive | None = None
    exposures_ms: Exposures | None = None
    rig: str | None = None
    noise: NoiseModel | None = None
    response: Positive | str | None = None
    camera: Word = ALONE.camera
    projector: Word = ALONE.projector
    frame_period_ms: Positive | None = None
    rolling_shutter_ms: NotNegative | None = None

    def timing(self) -> FrameTiming | None:
        """Return when pictures were taken, where it is stated.

        Raises
        ------
        InputError
            For a rolling shutter of pictures at no known times.
        """
        if self.frame_period_ms is None:
            if self.rolling_shutter_ms is not None:
                raise InputError("rolling_shutter_ms", "a frame_period_ms beside it", "none")
            return None
        rolling = 1e-3 * (self.rolling_shutter_ms or 0.0)
        return FrameTiming(period_s=1e-3 * self.frame_period_ms, rolling_s=rolling)


@dataclass(frozen=True, eq=False)
class ColourPictures:
    """Pictures of a camera in colour, whose channels a capture's frames are.

    Parameters
    ----------
    values : (M, V, U, 3) uint8 or uint16
        Red, green, blue.
    channel : {"red", "green", "blue"} or None
        The channel that is decoded of each; None where all three are, one after the other.
    """

    values: NDArray[Any]
    channel: Band | None = None

    def __repr__(self) -> str:
        count, rows, columns, _ = self.values.shape
        return f"<ColourPictures, {count} of {columns} x {rows} px>"

    @property
    def channels(self) -> tuple[int, ...]:
        """Indices of the channels that are decoded."""
        return (0, 1, 2) if self.channel is None else (BANDS.index(self.channel),)

    @property
    def frames(self) -> NDArray[Any]:
        """The frames that are decoded, (N, V, U)."""
        chosen = np.moveaxis(self.values[..., list(self.channels)], -1, 1)
        return np.ascontiguousarray(chosen).reshape(-1, *self.values.shape[1:3])

    def holds(self, frames: NDArray[Any]) -> bool:
        """Tell whether frames (N, V, U) are those that are decoded, value by value."""
        count, channels = len(self.values), self.channels
        if frames.shape != (count * len(channels), *self.values.shape[1:3]):
            return False
        return frames.dtype == self.values.dtype and all(
            np.array_equal(frames[k * len(channels) + i], picture[..., channel])
            for k, picture in enumerate(self.values)
            for i, channel in enumerate(channels)
        )

    def write(self, folder: Path) -> list[str]:
        """Write ``frames/000.png`` and so on to a folder; return what a manifest calls the frames.

        Such as ``frames/000.png#g``.
        """
        names = []
        for k, picture in enumerate(self.values):
            name = f"frames/{k:03d}.png"
            write_png(folder / name, picture)
            names += [f"{name}#{BANDS[channel][0]}" for channel in self.channels]
        return names


@dataclass(frozen=True, eq=False)
class Capture(Value):
    """The frames of one scan and what was projected.

    Parameters
    ----------
    frames : (N, V, U) uint8, uint16, float32 or float64
        Digital numbers, one frame a pattern.
    sequence : PatternSequence
        N frames.
    bit_depth : int or None
        Bits of a digital number; None for floats whose range is not known.
    noise : NoiseModel or None
        Temporal noise, for predicted deviations; None where it is not known.
    rig : Rig or None
        Geometry of the camera and the projector, where it is known.
    exposure_s : float or None
        The longest of several.
    saturation_dn : int or None
        Digital number at and above which a pixel is saturated; None is the top of the range,
        if there is one.
    min_modulation_dn : float or None
        Least modulation of a pixel that is measured; None is the decoder's own limit.
    pair : Pair
        Names of the camera that saw the frames and of the projector that showed the patterns.
    rig_covariance : ParameterCovariance or None
        What is known of the rig's parameters, for the uncertainty of points.
    response : Response or None
        Of the projector, which decoding takes out; None for one that is linear, or pictures that
        undo it.
    pictures : ColourPictures or None
        Of a simulated camera in colour; they are saved in the frames' place.  Dropped where the
        frames are not their channels: frames that were processed are saved themselves.
    bracket : Bracket or None
        All frames of several exposures, where a pixel's are those of one.  They are saved in the
        frames' place, and dropped likewise.
    timing : FrameTiming or None
        When pictures were taken, where something moved; None where it is not known.
    """

    frames: NDArray[Any]
    sequence: PatternSequence
    bit_depth: BitDepth | None = 8
    noise: NoiseModel | None = None
    rig: Rig | None = None
    exposure_s: Positive | None = None
    saturation_dn: GreyLevel | None = None
    min_modulation_dn: Grey | None = None
    pair: Pair = ALONE
    rig_covariance: ParameterCovariance | None = None
    response: Response | None = None
    pictures: ColourPictures | None = None
    bracket: Bracket | None = None
    timing: FrameTiming | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        frames = self.frames
        if frames.ndim != 3 or frames.dtype not in _TYPES or frames.size == 0:
            expected = "(N, V, U) uint8, uint16, float32 or float64"
            raise InputError("capture frames", expected, f"{frames.shape} {frames.dtype}")
        if len(frames) != self.sequence.n_frames:
            raise InputError(
                "capture frames",
                f"{self.sequence.n_frames}, as many as patterns ({self.sequence.name})",
                len(frames),
            )
        if self.bit_depth is None:
            if frames.dtype.kind != "f":
                raise InputError("bit_depth", f"the bits of {frames.dtype} frames", "none")
        else:
            top = 2**self.bit_depth - 1
            for key in ("saturation_dn", "min_modulation_dn"):
                value = getattr(self, key) or 0
                if value > top:
                    raise InputError(key, f"at most {top} DN, the top of the range", value)
            if frames.dtype.itemsize * 8 < self.bit_depth:
                raise InputError("capture frames", f"{self.bit_depth} bit frames", frames.dtype)
        if self.rig is not None:
            if self.rig.only != self.pair:
                raise InputError("rig", f"devices {self.pair}", self.rig.only)
            _check_sizes(self.rig, frames.shape, self.sequence.panel)
        for name in ("pictures", "bracket"):
            source = getattr(self, name)
            if source is not None and not source.holds(frames):
                object.__setattr__(self, name, None)
        if self.bracket is not None and any(part.spatial for part in self.sequence.parts):
            expected = "one exposure: these patterns are decoded by their neighbours in the picture"
            raise InputError("exposures_ms", expected, f"several, and {self.sequence.name}")

    def __repr__(self) -> str:
        count, rows, columns = self.frames.shape
        known = [name for name in ("noise", "rig") if getattr(self, name) is not None]
        bits = str(self.frames.dtype) if self.bit_depth is None else f"{self.bit_depth} bit"
        time = "" if self.exposure_s is None else f"exposure {1e3 * self.exposure_s:.4g} ms, "
        if self.bracket is not None:
            all_ms = ", ".join(f"{1e3 * one:.4g}" for one in self.bracket.times_s)
            time = f"exposures {all_ms} ms, "
        return block(
            f"Capture of {count} frames {columns} x {rows} px, {bits}: "
            f"{{{self.sequence.name}}} along {' and '.join(self.sequence.axes) or 'no axis'}",
            f"{time}known: {' and '.join(known) or 'neither noise nor rig'}",
        )

    @property
    def least_modulation_dn(self) -> float:
        """Least modulation of a pixel that is measured: `min_modulation_dn` or the default."""
        own = self.min_modulation_dn
        return MIN_MODULATION_DN if own is None else own

    @property
    def depth(self) -> int:
        """`bit_depth`, for what needs the range of the numbers.

        Raises
        ------
        InputError
            For floats whose range is not known.
        """
        if self.bit_depth is None:
            raise InputError("bit_depth", "the bits of the frames' floats, stated", "none")
        return self.bit_depth

    @property
    def top_dn(self) -> float:
        """Digital number at and above which a pixel is saturated; inf where there is none."""
        if self.saturation_dn is not None:
            return self.saturation_dn
        return inf if self.bit_depth is None else 2**self.bit_depth - 1

    @property
    def least_noise(self) -> NoiseModel:
        """The stated noise; else rounding to whole numbers, which floats have none of."""
        if self.noise is not None:
            return self.noise
        return NoiseModel(step_dn=0.0 if self.frames.dtype.kind == "f" else 1.0)

    def evened(self, picture: NDArray[Any]) -> NDArray[Any]:
        """Return a picture (V, U) of the frames' values as one exposure would have given it.

        It is the picture itself where there was but one.  Otherwise it is that of the longest, by
        the black level of the stated noise, and without a top.
        """
        if self.bracket is None:
            return picture
        return self.bracket.evened(picture, self.noise.offset_dn if self.noise else 0.0)

    def one_exposure(self, where: object) -> Capture:
        """Return the capture, for what takes frames of one exposure.

        Raises
        ------
        InputError
            For one of several, naming `where`.
        """
        if self.bracket is not None:
            got = f"exposures_ms, {len(self.bracket.times_s)} of them"
            raise InputError(where, "a capture of one exposure", got)
        return self

    def apart(self) -> Capture:
        """Return the channels of colour pictures as frames of their own; itself without any."""
        matrix, noise = self.sequence.crosstalk, self.noise
        if matrix is None:
            return self
        return replace(
            self,
            frames=unmixed(self.frames, matrix, noise.offset_dn if noise else 0.0, self.top_dn),
            sequence=replace(self.sequence, crosstalk=None),
            noise=None if noise is None else amplified(noise, matrix),
            bit_depth=None,
            saturation_dn=None,
            pictures=None,
        )

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
            noise=self.least_noise,
            saturation=self.top_dn,
            min_modulation=self.least_modulation_dn if min_modulation is None else min_modulation,
            response=self.response,
            **options,
        )

    def plot(self) -> Any:
        """Return a matplotlib figure: the frames, or an even choice of many."""
        return figure(self)

    def save(self, folder: str | Path) -> None:
        """Write frames, manifest, rig and provenance to `folder`; all or nothing.

        The modules that its codes came from stand beside them.

        Raises
        ------
        InputError
            If what slbench did not write is in the way, or a file cannot be written.
        """
        with _FOLDER.writing(folder, {"patterns": self.sequence.name}, None) as temporary:
            self.write_into(temporary)

    def write_into(self, folder: str | Path) -> None:
        """Write frames, manifest and rig as part of a folder that is being made."""
        root = Path(folder)
        (root / "frames").mkdir(parents=True, exist_ok=True)
        if self.pictures is not None:
            names = self.pictures.write(root)
        else:
            frames = self.frames
            if self.bracket is not None:
                frames = self.bracket.values.reshape(-1, *frames.shape[1:])
            floats = frames.dtype.kind == "f"
            suffix, write = ("tif", write_tiff) if floats else ("png", write_png)
            names = [f"frames/{k:03d}.{suffix}" for k in range(len(frames))]
            for name, frame in zip(names, frames, strict=True):
                write(root / name, frame)
        manifest: dict[str, Any] = {
            "format": _FORMAT,
            "bit_depth": self.bit_depth,
            "frames": names,
            "patterns": self.sequence.to_dict(root),
        }
        if self.bit_depth is None:
            del manifest["bit_depth"]
        modules = save_modules(
            (pattern_codes.origin(part.kind) for part in self.sequence.parts), root
        )
        if modules:
            manifest["modules"] = modules
        if self.pair != ALONE:
            manifest |= self.pair._asdict()
        if self.saturation_dn is not None:
            manifest["saturation_dn"] = self.saturation_dn
        if self.min_modulation_dn is not None:
            manifest["min_modulation_dn"] = self.min_modulation_dn
        if self.bracket is not None:
            manifest["exposures_ms"] = [one * 1e3 for one in self.bracket.times_s]
        elif self.exposure_s is not None:
            manifest["exposure_ms"] = self.exposure_s * 1e3
        if self.timing is not None:
            manifest["frame_period_ms"] = self.timing.period_s * 1e3
            if self.timing.rolling_s:
                manifest["rolling_shutter_ms"] = self.timing.rolling_s * 1e3
        if self.noise is not None:
            manifest["noise"] = asdict(self.noise)
        if self.response is not None:
            manifest["response"] = self.response.write(root)
        if self.rig is not None:
            write_rig(root / "rig.yaml", self.rig, self.rig_covariance)
            manifest["rig"] = "rig.yaml"
        write_toml(root / MANIFEST, manifest)

    @classmethod
    def load(
        cls, folder: str | Path, *, allow_modules: bool = False, allow_outside: bool = False
    ) -> Capture:
        """Read a folder with a manifest: what :meth:`save` wrote, or real photographs.

        Parameters
        ----------
        folder : path
        allow_modules : bool
            Run the Python modules that the manifest names: code of its author.
        allow_outside : bool
            Read frames and the rig outside the folder too, links included.

        Raises
        ------
        InputError
            Naming the file and key at fault: a missing manifest or frame, frames of
            different sizes, a path that leaves the folder.

        Warns
        -----
        InputWarning
            If 16-bit files hold fewer bits, left-aligned: frames and the manifest's numbers of the
            same scale are shifted down.  If floats are so small that nothing could be measured.
        """
        path = manifest_path(folder)
        manifest = read_toml(path)
        if "pairs" in manifest:
            expected = "the capture of one camera and one projector; `slbench decode` takes several"
            raise InputError(f"{path}: pairs", expected, "several")
        return cls.of_manifest(
            path, manifest, allow_modules=allow_modules, allow_outside=allow_outside
        )

    @classmethod
    def of_manifest(
        cls,
        path: Path,
        manifest: dict[str, Any],
        *,
        where: str | None = None,
        allow_modules: bool = False,
        allow_outside: bool = False,
    ) -> Capture:
        """Return the capture that the keys of a manifest describe; see :meth:`load`.

        Parameters
        ----------
        path : Path
            Of the manifest, beside which files are looked for.
        manifest : dict
        where : str, optional
            What to name in refusals, a table in the file; else the file.
        allow_modules, allow_outside : bool
            As :meth:`load` has them.
        """
        where = where or str(path)
        table = validated(CaptureTable, manifest, where, ": ")
        load_modules(table.modules, path.parent, allow_modules, f"{path}: modules")
        with located(where):
            sequence = PatternSequence.from_dict(manifest["patterns"], path.parent)
            times_ms = table.exposures_ms or ()
            if times_ms and table.exposure_ms is not None:
                raise InputError("exposures_ms", "none beside exposure_ms", "both")
            check_exposures(times_ms, "exposures_ms")
            name = sequence.name
            if len(times_ms) > 1:
                name += f" at {len(times_ms)} exposures"
            count = max(len(times_ms), 1) * sequence.n_frames
            files = frame_files(path.parent, table.frames, count, name, allow_outside)
            frames, bits = read_frames(files)
            shift = 0
            if table.bit_depth is None and frames.dtype == np.uint16:
                shift = left_aligned(bits)
            if shift:
                warn_user(
                    where,
                    f"the low {shift} bits of all frames are zero: taken for {16 - shift} bit, "
                    f"left-aligned, and shifted down (bit_depth = 16 keeps them)",
                )
                frames = shifted(frames, shift)
            bit_depth: Any = table.bit_depth
            if bit_depth is None and frames.dtype.kind != "f":
                bit_depth = 16 - shift if shift else 8 * frames.dtype.itemsize
            pair = Pair(table.camera, table.projector)
            rig = covariance = None
            if table.rig is not None:
                place = allowed(path.parent, table.rig, allow_outside)
                rig, covariance = read_rig(place, pair).pair(pair), covariance_beside(place)
            noise = table.noise
            # The least value that reaches it once it is shifted.
            saturation = table.saturation_dn
            if saturation:
                saturation = min(-(-saturation >> shift), 2 ** (16 - shift) - 1)
            exposure_ms, bracket = table.exposure_ms, None
            if times_ms:
                exposure_ms = max(times_ms)
            if len(times_ms) > 1:
                top = inf if bit_depth is None else 2**bit_depth - 1
                values = frames.reshape(len(times_ms), -1, *frames.shape[1:])
                times_s = [1e-3 * one for one in times_ms]
                bracket = Bracket.of(values, times_s, saturation or top)
                frames = bracket.frames
            capture = cls(
                frames,
                sequence,
                bit_depth,
                _shifted_noise(noise, shift, manifest.get("noise", {})),
                rig,
                None if exposure_ms is None else exposure_ms * 1e-3,
                saturation,
                table.min_modulation_dn and table.min_modulation_dn / 2**shift,
                pair,
                covariance,
                _response(table.response, path.parent, allow_outside),
                bracket=bracket,
                timing=table.timing(),
            )
        if frames.dtype.kind == "f":
            _question_scale(where, capture)
        return capture


def manifest_path(folder: str | Path) -> Path:
    """Return the manifest of a capture's folder; a file that ends in .toml is it itself."""
    root = Path(folder)
    return root if root.suffix.lower() == ".toml" else root / MANIFEST


def _response(given: float | str | None, folder: Path, allow_outside: bool) -> Response | None:
    """Return the response that a manifest states by a gamma or a file."""
    if given is None:
        return None
    if isinstance(given, str):
        return Response.read(allowed(folder, given, allow_outside))
    return Response(float(given))


def _question_scale(where: str, capture: Capture) -> None:
    """Question floats that are too small for any modulation to be measured."""
    least, frames = capture.least_modulation_dn, capture.frames
    largest = np.max(frames, initial=-inf, where=np.isfinite(frames))
    if -inf < largest < 2.0 * least:
        warn_user(
            where,
            f"no value is above {largest:.3g}, and a modulation below {least:g} is not measured: "
            "frames of full scale 1 need a smaller min_modulation_dn",
        )


def _shifted_noise(
    noise: NoiseModel | None, shift: int, stated: dict[str, Any]
) -> NoiseModel | None:
    """Return a noise model of the files' numbers for frames that were shifted down."""
    if noise is None or not shift:
        return noise
    scale = 0.5**shift
    return replace(
        noise,
        read_dn=scale * noise.read_dn,
        gain_dn_per_e=scale * noise.gain_dn_per_e,
        offset_dn=scale * noise.offset_dn,
        step_dn=scale * noise.step_dn if "step_dn" in stated else noise.step_dn,
    )


def read_capture(
    folder: str | Path, *, allow_modules: bool = False, allow_outside: bool = False
) -> Capture:
    """Read a folder of frames with its ``capture.toml``, simulated or photographed.

    The function of :meth:`Capture.load`, which says what is raised.
    """
    return Capture.load(folder, allow_modules=allow_modules, allow_outside=allow_outside)


def _check_sizes(rig: Rig, frames: tuple[int, ...], panel: tuple[int, int]) -> None:
    camera, projector = rig.camera, rig.projector
    if frames[1:] != (camera.height, camera.width):
        raise InputError(
            "frames",
            f"the rig's {camera.width} x {camera.height} px",
            f"{frames[2]} x {frames[1]} px{_scaled_by(frames, camera)}",
        )
    if panel != (projector.width, projector.height):
        raise InputError(
            "patterns.panel",
            f"the rig's {projector.width} x {projector.height} px",
            f"{panel[0]} x {panel[1]} px",
        )


def _scaled_by(frames: tuple[int, ...], camera: Camera) -> str:
    """Say by what whole factor frames are smaller or larger than a camera's, if by one."""
    for factor in range(2, 17):
        for one, other, word in (
            (frames[1:], (camera.height, camera.width), "smaller"),
            ((camera.height, camera.width), frames[1:], "larger"),
        ):
            # An odd row or column is left out in binning.
            if all(0 <= b - factor * a < factor for a, b in zip(one, other, strict=True)):
                return f", {factor} times {word}: a calibration at another resolution?"
    return ""
