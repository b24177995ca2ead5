"""Focus stacks: captures of one scene at several focus settings, fused pattern by pattern.

The lit frames of all settings say where each setting is sharp (:mod:`slbench.capture.fusion`); the
same weights fuse every pattern (thesis 5.4.2).  In memory a stack is a list of captures; on
disk a folder with a ``stack.toml`` and one capture folder a setting, of which one frame at a
time is read, so that a large stack need not fit into memory.

``weights="modulation"`` goes beyond the thesis: a surface without texture looks the same at
all settings, and a projector out of focus does not show in the lit frame at all.  Both show in
the modulation of the finest fringes, pixel by pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import CAPTURE_ENTRIES, Capture
from slbench.capture.capture import MANIFEST as CAPTURE_MANIFEST
from slbench.capture.focus import Focus
from slbench.capture.fusion import Alignment, FusionWeights, Stack, selective_weights
from slbench.capture.fusion.exposure import Balanced, differ, frame_gains
from slbench.capture.fusion.measures import check_window
from slbench.capture.fusion.photographs import FusionMethod, undone
from slbench.capture.fusion.stack import Banded, Held
from slbench.capture.reading import FrameFile, allowed, check_alike, frame_files, shifted
from slbench.core.errors import InputError, located, warn_user
from slbench.core.io import OutputFolder, read_toml, write_exr, write_toml
from slbench.core.registry import quoted
from slbench.core.show.display import block, brief
from slbench.core.show.drawing import figure
from slbench.core.validation.types import Measure, MinLen, Word
from slbench.core.validation.values import validated
from slbench.patterns import NoiseModel, PhaseMap
from slbench.patterns.phase import squared_modulation_bias
from slbench.rig import ALONE, Pair

Array = NDArray[np.float64]
WeightSource = Literal["lit", "modulation"]

MANIFEST = "stack.toml"
FUSED_FOLDER = OutputFolder("fused capture", (*CAPTURE_ENTRIES, "fusion.exr"))
_FOLDER = OutputFolder("focus stack", (MANIFEST, "focus[0-9]*"))
_FORMAT = 1
#: Behind the name of a device: its distances in focus.
_FOCUS = "_mm"
#: Fused frames have 16 bits: averages are finer than the frames that they are made of.
_BITS: Final = 16
#: A fused pixel counts as saturated when this share of its weight is.
_SATURATED_SHARE = 0.01
#: Exposures of the settings that differ by more are worth a warning.
_UNLIKE = 1.05
#: Modulation that is nothing but rounding, DN: there all settings count alike.
_DARK = 1e-6
#: Side of the window in which the strongest setting is found, px.
_NEAR: Final = 3
#: A modulation of fewer standard errors is taken for noise: one in 44 where there is none.
_SEEN_SIGMAS: Final = 2.0
#: Weight of the best setting.
_FULL = 65535


@dataclass(frozen=True, eq=False)
class FusedCapture:
    """A stack fused into one capture.

    Parameters
    ----------
    capture : Capture
        16-bit frames, one a pattern; its noise model is that of a single frame.
    weights : FusionWeights or None
        None for a single picture, which is as it was taken.
    """

    capture: Capture
    weights: FusionWeights | None = None

    @property
    def noise_gain(self) -> Array | float:
        """Deviation of the fused frames over that of single ones, (V, U), or 1."""
        return 1.0 if self.weights is None else self.weights.noise_gain

    __repr__ = brief

    def decode(self, **options: Any) -> PhaseMap:
        """Decode the fused frames; deviations are lessened by what the average gains."""
        phase = self.capture.decode(**options)
        gain = self.noise_gain
        return replace(phase, sigma={axis: gain * sigma for axis, sigma in phase.sigma.items()})

    def save(self, folder: str | Path) -> None:
        """Write the capture and, if the weights have maps, ``fusion.exr``; all or nothing.

        Raises
        ------
        InputError
            As :meth:`Capture.save <slbench.capture.capture.Capture.save>`.
        """
        parameters = {"patterns": self.capture.sequence.name}
        with FUSED_FOLDER.writing(folder, parameters, None) as temporary:
            self.capture.write_into(temporary)
            if isinstance(self.weights, FusionWeights):
                maps = {
                    "focus": self.weights.focus,
                    "selectivity": self.weights.selectivity_db,
                    "noise_gain": self.weights.noise_gain,
                }
                channels = {name: values.astype(np.float32) for name, values in maps.items()}
                write_exr(temporary / "fusion.exr", channels)


@dataclass(frozen=True, eq=False)
class FocusStack:
    """Captures of the same patterns at several focus settings.

    Parameters
    ----------
    captures : sequence of Capture
        One a setting, equal but for their frames.  May read from disk when indexed.
    focus : Focus or None
        The settings, where they are known.
    reader : callable, optional
        ``reader(setting, frame)`` gives one frame without loading its capture.

    Raises
    ------
    InputError
        For no captures, captures that differ or that have several exposures.
    """

    captures: Sequence[Capture]
    focus: Focus | None = None
    reader: Callable[[int, int], NDArray[Any]] | None = None

    def __post_init__(self) -> None:
        if len(self.captures) == 0:
            raise InputError("focus stack", "at least one capture", "none")
        if self.focus is not None and len(self.focus) != len(self.captures):
            raise InputError(
                "focus stack", f"a capture for each of {len(self.focus)} settings", len(self)
            )
        if self.reader is None:
            first = self.captures[0]
            for k, other in enumerate(self.captures):
                if self.focus is not None or len(self) > 1:
                    other.one_exposure(f"focus stack: captures[{k}]")
                _check_alike(f"focus stack: captures[{k}]", first, other)

    def __len__(self) -> int:
        return len(self.captures)

    def __repr__(self) -> str:
        focus = "" if self.focus is None else repr(self.focus)
        return block(
            f"FocusStack of {len(self)} captures; the first:", repr(self.captures[0]), focus
        )

    @property
    def lit_frame(self) -> int:
        """Index of the fully lit frame.

        Raises
        ------
        InputError
            If the patterns have none.
        """
        sequence = self.captures[0].sequence
        if sequence.lit_frame is not None:
            return sequence.lit_frame
        raise InputError(
            "focus stack", "a fully lit frame (white) among the patterns", sequence.name
        )

    def frame(self, setting: int, index: int) -> NDArray[Any]:
        """Return one frame, (V, U)."""
        if self.reader is not None:
            return self.reader(setting, index)
        return self.captures[setting].frames[index]

    def weights(self, source: WeightSource = "lit", **options: Any) -> FusionWeights:
        """Find where each setting is sharp.

        Parameters
        ----------
        source : {"lit", "modulation"}
            The texture of the lit frames (thesis), or the modulation of the finest fringes.
        options
            For :func:`slbench.capture.fusion.selective_weights` or :func:`modulation_weights`.

        Returns
        -------
        FusionWeights
            Focus positions are indices of the settings.

        Raises
        ------
        InputError
            For a stack without the frames that are needed.
        """
        if source == "lit":
            return selective_weights(self.balanced(self.lit()), **options)
        if source != "modulation":
            raise InputError("weights", "lit or modulation", repr(source))
        return modulation_weights(self, **options)

    def fuse(self, source: WeightSource = "lit", **options: Any) -> FusedCapture:
        """Fuse every pattern with the weights of :meth:`weights`; a single picture is kept."""
        if self.focus is None and len(self) == 1:
            return FusedCapture(self.captures[0])
        return self.fuse_with(self.weights(source, **options))

    def fuse_by(self, method: FusionMethod) -> FusedCapture:
        """Fuse every pattern by the lit frames' weights of a method, aligned by them if it says.

        Warns
        -----
        InputWarning
            If focusing has moved the frames and `method` leaves open what is to be done ("auto"):
            aligned frames are what another camera would see, which a calibration must know.
        """
        lit: Any = self.lit()
        alignment = undone(lit, method.motion, "focus stack")
        if alignment is not None and method.motion == "auto":
            shift = alignment.shift_px(*lit[0].shape)
            why = f"focusing moves them by up to {shift:.1f} px; --align magnification undoes it"
            warn_user("focus stack: frames", why)
            alignment = None
        if alignment is not None:
            lit = alignment.apply(lit)
        return self.fuse_with(method.weights(self.balanced(lit)), alignment)

    def balanced(self, lit: Stack) -> Stack:
        """Return lit frames of one exposure, so that no weight is of the exposure.

        The other frames need none of it: a pixel's frames are all fused with the same weights,
        and what a setting's exposure does to all of them alike changes no phase.

        Warns
        -----
        InputWarning
            If the exposures differ by more than five per cent.
        """
        gains = frame_gains(lit, len(self) // 2, 1.0)
        if not differ(gains):
            return lit
        ratio = gains.max() / gains.min()
        if ratio > _UNLIKE:
            why = f"exposures differ by {100 * (ratio - 1):.0f} %: turn off automatic exposure"
            warn_user("focus stack: lit frames", why)
        return Balanced(lit, gains)

    def lit(self) -> Sequence[Array]:
        """Return the lit frames of all settings, full scale 1, read when they are asked for."""
        return _Frames(self, self.lit_frame, 1.0 / (2 ** self.captures[0].depth - 1))

    def fuse_with(self, weights: Any, alignment: Alignment | None = None) -> FusedCapture:
        """Fuse every pattern with given weights.

        Parameters
        ----------
        weights : FusionWeights, or anything else with their ``fuse`` and ``noise_gain``
        alignment : Alignment, optional
            Of the lit frames; every pattern's are moved by it first.
        """

        def fused(index: int, scale: float, saturation: int | None = None) -> Array:
            frames = _Frames(self, index, scale, saturation)
            return weights.fuse(frames if alignment is None else alignment.apply(frames))

        first = self.captures[0]
        scale = 2.0 ** (_BITS - first.depth)
        saturation = first.saturation_dn or 2**first.depth - 1
        frames = np.empty((len(first.sequence.frames()), *first.frames.shape[1:]), np.uint16)
        for k in range(len(frames)):
            image = fused(k, scale)
            if any(self.frame(p, k).max() >= saturation for p in range(len(self))):
                share = fused(k, 1.0, saturation)
                image = np.where(share > _SATURATED_SHARE, scale * saturation, image)
            frames[k] = np.clip(np.rint(image), 0, 2**_BITS - 1)
        capture = Capture(
            frames,
            first.sequence,
            _BITS,
            _scaled(first.noise or NoiseModel(), scale),
            first.rig,
            first.exposure_s,
            int(scale * saturation),
            scale * first.least_modulation_dn,
            first.pair,
        )
        return FusedCapture(capture, weights)

    def plot(self) -> Any:
        """Return a matplotlib figure: a lit frame of every setting."""
        return figure(self)

    def save(self, folder: str | Path) -> None:
        """Write one capture folder a setting, ``stack.toml`` and provenance; all or nothing.

        Raises
        ------
        InputError
            As :meth:`Capture.save <slbench.capture.capture.Capture.save>`.
        """
        with _FOLDER.writing(folder, {"settings": len(self)}, None) as temporary:
            self.write_into(temporary)

    def write_into(self, folder: str | Path) -> None:
        """Write captures and manifest as part of a folder that is being made."""
        root = Path(folder)
        names = [f"focus{k:03d}" for k in range(len(self))]
        for name, capture in zip(names, self.captures, strict=True):
            capture.write_into(root / name)
        manifest: dict[str, Any] = {"format": _FORMAT, "captures": names}
        if self.focus is not None:
            distances = self.focus.distances_mm.items()
            manifest |= {name + _FOCUS: list(values) for name, values in distances}
        write_toml(root / MANIFEST, manifest)

    @classmethod
    def load(
        cls, folder: str | Path, *, allow_modules: bool = False, allow_outside: bool = False
    ) -> FocusStack:
        """Open a folder with a ``stack.toml``; frames are read when they are needed.

        Parameters
        ----------
        folder : path
        allow_modules, allow_outside : bool
            As for :meth:`Capture.load <slbench.capture.capture.Capture.load>`.

        Raises
        ------
        InputError
            Naming the file and key at fault; a capture that differs from the first.
        """
        path = Path(folder) / MANIFEST
        manifest = read_toml(path)
        distances = tuple(key for key in manifest if key.endswith(_FOCUS))
        table = validated(_stack_table(distances), manifest, str(path), ": ")
        captures = _Folders(path, table.captures, allow_modules, allow_outside)
        focus = _focus(path, {key: getattr(table, key) for key in distances}, captures[0].pair)
        return cls(captures, focus, captures.frame)


def read_stack(
    folder: str | Path, *, allow_modules: bool = False, allow_outside: bool = False
) -> FocusStack:
    """Open a folder of captures with its ``stack.toml``.

    The function of :meth:`FocusStack.load`, which says what is raised.
    """
    return FocusStack.load(folder, allow_modules=allow_modules, allow_outside=allow_outside)


class _Folders(Sequence[Capture]):
    """Captures on disk, alike by their manifests; the first is kept."""

    def __init__(
        self, path: Path, names: Sequence[str], allow_modules: bool, allow_outside: bool
    ) -> None:
        self._allow = {"allow_modules": allow_modules, "allow_outside": allow_outside}
        self._folders = [allowed(path.parent, name, allow_outside) for name in names]
        self._first = Capture.load(self._folders[0], **self._allow)
        self._first.one_exposure(f"{path}: {names[0]}")
        self._shift = 0
        self._frames: list[list[FrameFile]] = []
        alike: dict[str, Any] = {}
        patterns = self._first.sequence
        for name, folder in zip(names, self._folders, strict=True):
            manifest = read_toml(folder / CAPTURE_MANIFEST)
            entries = manifest.pop("frames", None)
            texts = [entries] if isinstance(entries, str) else entries
            if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
                raise InputError(f"{path}: {name}: frames", "files, a list", repr(entries)[:60])
            manifest.pop("rig", None)  # differs in its focus
            alike = alike or manifest
            for key in sorted({*alike, *manifest}):
                if manifest.get(key) != alike.get(key):
                    where = f"{path}: {name}: {key}"
                    got = repr(manifest.get(key))[:60]
                    raise InputError(where, "what the first capture has", got)
            with located(f"{path}: {name}"):
                count = patterns.n_frames
                files = frame_files(folder, texts, count, patterns.name, allow_outside)
            self._frames.append(files)
        if "bit_depth" not in alike and self._first.bit_depth not in (None, 16):
            deep = self._frames[0][0].read()[0].dtype == np.uint16  # of fewer bits, left-aligned
            self._shift = 16 - self._first.depth if deep else 0

    def __len__(self) -> int:
        return len(self._folders)

    def __getitem__(self, index: Any) -> Any:
        if index == 0:
            return self._first
        return Capture.load(self._folders[index], **self._allow)

    def frame(self, setting: int, index: int) -> NDArray[Any]:
        """Read one frame."""
        file = self._frames[setting][index]
        image, bits = file.read()
        if bits & ((1 << self._shift) - 1):
            expected = f"left-aligned values of {16 - self._shift} bit, as the first capture's"
            raise InputError(file.path, expected, f"the bits {bits:#06x}")
        image = shifted(image, self._shift)
        check_alike(file.path, image, self._first.frames)
        return image


class _Frames(Sequence[Array]):
    """One pattern at all settings, times `scale`; or where it is saturated."""

    def __init__(
        self, stack: FocusStack, index: int, scale: float, saturation: int | None = None
    ) -> None:
        self._stack, self._index, self._scale = stack, index, scale
        self._saturation = saturation

    def __len__(self) -> int:
        return len(self._stack)

    def __getitem__(self, setting: Any) -> Any:
        frame = self._stack.frame(setting, self._index)
        if self._saturation is not None:
            return (frame >= self._saturation).astype(np.float64)
        return frame * self._scale

    def banded(self) -> Banded:
        """Return the same by bands of rows; the frames are held as deep as they are."""
        frames = [self._stack.frame(setting, self._index) for setting in range(len(self))]
        return _FrameBands(frames, self._scale)


class _FrameBands(Held):
    """One pattern at all settings by bands of rows, times `scale`."""

    def __init__(self, frames: Sequence[NDArray[Any]], scale: float) -> None:
        super().__init__(frames)
        self._scale = scale

    def rows(self, index: int, top: int, bottom: int) -> NDArray[Any]:
        return super().rows(index, top, bottom) * self._scale


def modulation_weights(stack: FocusStack, window: int = 9) -> FusionWeights:
    """Weight the settings by their modulation of the finest fringes.

    The sum of frames with weights w_p has the modulation sum w_p b_p and, for equal noise, the
    deviation sqrt(sum w_p^2) times that of one: their ratio, and with it the phase, is best for
    w_p in proportion to b_p (the matched filter).  b_p is taken in step with the strongest
    setting's fringes, so that contrast reversed by defocus counts as none, and averaged over a
    window.  The noise of the frames takes no part in the mean of a weight: the strongest setting
    is that of most power around a pixel, its product with itself has the power of noise taken off
    (:func:`slbench.patterns.phase.squared_modulation_bias`), and what is less than twice its own
    standard error counts as none, so that settings whose fringes are lost do not add noise.
    Without a noise model of the captures, rounding is the only noise that is known.

    Parameters
    ----------
    stack : FocusStack
    window : int
        Side of the window, px; odd.

    Returns
    -------
    FusionWeights
        ``focus`` is the index of the strongest setting; selectivity is not defined (NaN).
    """
    sequence = stack.captures[0].sequence
    finest = sequence.finest()
    if finest is None:
        raise InputError("focus stack", "fringes, for weights by modulation", sequence.name)
    check_window(window, 1)
    noise = stack.captures[0].noise or NoiseModel()
    waves: list[Any] = []  # the largest thing here: eight bytes a pixel and setting
    near = (min(window, _NEAR),) * 2
    for setting in range(len(stack)):
        frames = np.stack([stack.frame(setting, k) for k in finest.frames])
        phase, modulation, mean = finest.code.relative_phase(frames, sequence.panel)
        waves.append((modulation * np.exp(1j * phase)).astype(np.complex64))
        bias = squared_modulation_bias(noise.variance(mean), len(frames)).astype(np.float32)
        power = cv2.blur(np.square(modulation, dtype=np.float32) - bias, near)
        if setting == 0:
            reference, most, noise_power = waves[0].copy(), power, bias
            best = np.zeros(power.shape, dtype=np.intp)
            continue
        better = power > most
        best[better], most[better], noise_power[better] = setting, power[better], bias[better]
        reference[better] = waves[setting][better]
    # The modulation of the strongest: of noise alone, what noise has.
    scale = 1.0 / np.sqrt(np.maximum(most, np.maximum(noise_power, _DARK**2)))
    reference = scale * np.conj(reference)
    square = cv2.blur(0.5 * noise_power * np.abs(reference) ** 2, (window, window))
    least = (_SEEN_SIGMAS / window) * np.sqrt(square.clip(min=0.0))  # of rounded sums
    peak = np.zeros(reference.shape, dtype=np.float32)
    for setting, wave in enumerate(waves):
        product = (wave * reference).real
        product -= np.where(best == setting, noise_power * scale, np.float32(0.0))
        in_step = cv2.blur(product, (window, window))
        in_step[in_step < np.maximum(least, _DARK)] = 0.0
        waves[setting] = in_step  # and the wave is let go
        np.maximum(peak, in_step, out=peak)
    seen = peak > 0.0
    largest = np.where(seen, peak, 1.0)
    weights = np.empty((len(waves), *peak.shape), dtype=np.uint16)
    for setting, in_step in enumerate(waves):
        weights[setting] = np.rint(_FULL * np.where(seen, in_step / largest, 1.0))
    nowhere = np.full(peak.shape, np.nan)
    return FusionWeights(weights, np.where(seen, best, np.nan), nowhere)


def _check_alike(where: str, first: Capture, other: Capture) -> None:
    if other.sequence != first.sequence:
        raise InputError(where, f"the patterns of the first, {first.sequence.name}", "others")
    if other.frames.shape != first.frames.shape or other.bit_depth != first.bit_depth:
        expected = f"{first.frames.shape} with {first.bit_depth} bits, as the first"
        raise InputError(where, expected, f"{other.frames.shape} with {other.bit_depth}")


def _stack_table(distances: tuple[str, ...]) -> Any:
    """Return the model of a ``stack.toml`` that has these keys with distances of devices."""
    from pydantic import create_model

    from slbench.core.validation.tables import Parameters

    names = dict.fromkeys((*(f"{name}{_FOCUS}" for name in ALONE), *distances))
    fields: Any = dict.fromkeys(names, (tuple[Measure, ...] | None, None))
    captures = Annotated[tuple[Word, ...], MinLen(1)]
    return create_model(
        "Stack", __base__=Parameters, format=(Literal[1], 1), captures=(captures, ...), **fields
    )


def _focus(path: Path, given: Mapping[str, tuple[float, ...]], devices: Pair) -> Focus | None:
    names = {name + _FOCUS: name for name in devices}
    if not given:
        return None
    for key in given:
        if key not in names:
            raise InputError(path, f"{' and '.join(names)}, one or neither", quoted(key, [*names]))
    with located(path):
        return Focus({names[key]: values for key, values in given.items()})


def _scaled(noise: NoiseModel, scale: float) -> NoiseModel:
    """Return the noise of frames multiplied by `scale` and rounded again.

    The first rounding becomes part of the constant noise.
    """
    return NoiseModel(
        read_dn=scale * float(np.sqrt(noise.constant_variance)),
        gain_dn_per_e=scale * noise.gain_dn_per_e,
        offset_dn=scale * noise.offset_dn,
        step_dn=1.0,
    )
