"""Everything that captures of one camera and projector tell of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slbench.calibration.characterise import (
    drift,
    fixed_pattern,
    motion,
    noise,
    response,
    shading,
    spread,
)
from slbench.calibration.characterise.frames import Shot, check_alike, flats, shots
from slbench.calibration.characterise.quantity import Quantity, Untold
from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.show.display import block
from slbench.core.show.document import Table
from slbench.patterns import Fringes

#: From this vibration on what it leaves of fringes, to third order, counts beside photons' noise.
_SHAKEN_PX = 0.1
#: Levels of flat frames that tell a line by themselves: they hardly change when they move.
_LEVELS = 2


@dataclass(frozen=True, eq=False, kw_only=True)
class Characterisation:
    """What was measured of a camera and a projector, and what was not.

    Parameters
    ----------
    folders : tuple of str
    bit_depth : int or None
        Of the frames.
    quantities : tuple of Quantity
    untold : tuple of Untold
    transfer : Transfer or None
        Photon transfer, for the picture.
    curve : Curve or None
        The projector's response.
    contrasts : tuple of Contrast
        Contrast of fringes, of each axis.
    series : tuple of Series
        What was followed over time.
    """

    folders: tuple[str, ...]
    bit_depth: int | None
    quantities: tuple[Quantity, ...]
    untold: tuple[Untold, ...]
    transfer: noise.Transfer | None = None
    curve: response.Curve | None = None
    contrasts: tuple[spread.Contrast, ...] = ()
    series: tuple[drift.Series, ...] = ()

    def __repr__(self) -> str:
        lines = [f"{one.name}: {one}" for one in self.quantities]
        return block(f"Characterisation of {len(self.folders)} captures", *lines)

    def __getitem__(self, name: str) -> Quantity:
        """Return a quantity by its name.

        Raises
        ------
        InputError
            Where it was not told, with the reason.
        """
        for one in self.quantities:
            if one.name == name:
                return one
        why = next((lost.why for lost in self.untold if lost.name == name), "none of that name")
        raise InputError("characterise", f"a measured {name}", why)

    def table(self) -> Table:
        """Return the quantities with their intervals and methods."""
        rows = tuple(
            (one.name, one.value, f"{one.low:.4g} to {one.high:.4g}", one.unit, one.method)
            for one in self.quantities
        )
        return Table("Characterisation", ("quantity", "value", "95 %", "unit", "by"), rows)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "folders": list(self.folders),
            "bit_depth": self.bit_depth,
            "quantities": [one.to_dict() for one in self.quantities],
            "untold": [one._asdict() for one in self.untold],
            "photon_transfer": _plain(self.transfer),
            "response": _plain(self.curve),
            "contrast": [_plain(one) for one in self.contrasts],
            "drift": [_plain(one) for one in self.series],
        }


def _plain(
    curve: noise.Transfer | response.Curve | spread.Contrast | drift.Series | None,
) -> dict[str, Any] | None:
    if curve is None:
        return None
    return {key: np.asarray(value).tolist() for key, value in curve._asdict().items()}


@dataclass
class _Found:
    """What is gathered on the way."""

    quantities: list[Quantity] = field(default_factory=list)
    untold: list[Untold] = field(default_factory=list)

    def take(self, quantities: Sequence[Quantity], untold: Sequence[Untold] = ()) -> None:
        self.quantities += quantities
        self.untold += untold


def characterise(
    captures: Mapping[str, Capture],
    *,
    black_dn: float | None = None,
    edge: tuple[int, int, int, int] | None = None,
    even: Mapping[str, Capture] | None = None,
    hours: Sequence[float] | None = None,
) -> Characterisation:
    """Measure what captures tell of their camera and projector.

    Parameters
    ----------
    captures : mapping of str to Capture
        By the name of the folder; frames that show the same are repeats, wherever they are.
    black_dn : float, optional
        Black level; by default that of the black frames, or else what a capture states.
    edge : (u, v, width, height), optional
        Window of the white frame that holds one straight edge, a little turned to the pixels.
    even : mapping of str to Capture, optional
        Pictures of a surface that is equally bright everywhere, for the camera's shading.
    hours : sequence of float, optional
        When each of the captures was taken, for slow drift.

    Returns
    -------
    Characterisation

    Raises
    ------
    InputError
        For captures of different cameras, or of colour pictures alone; for a window without an
        edge.
    """
    evenly = even or {}
    check_alike({**captures, **evenly})
    found = shots(captures)
    if not found:
        expected = "a capture of grey frames: channels of a picture are no frames of their own"
        raise InputError(next(iter(captures)), expected, "colour pictures (crosstalk)")
    one = next(iter(captures.values()))
    top, step = one.top_dn, 0.0 if one.frames.dtype.kind == "f" else 1.0
    samples: dict[int, noise.Sample] = {}
    moves: dict[int, motion.Moves] = {}
    for k, shot in enumerate(found):
        if len(shot.frames) > 1:
            moves[k], still = motion.moves_of(shot.stack(), top)
            samples[k] = noise.of_repeats(still, top)
    whole = _Found()
    stated = next((c.noise.offset_dn for c in captures.values() if c.noise is not None), 0.0)
    black = _black(found, samples, black_dn, stated, step)
    if black is not None:
        whole.quantities.append(
            Quantity(
                name="black level",
                value=black[0],
                low=black[0] - 1.96 * black[1],
                high=black[0] + 1.96 * black[1],
                unit="DN",
                method="black frames" if black_dn is None else "stated",
                key=("detector", "offset_dn"),
                note="dark signal and stray light of the black frames count too",
            )
        )
    shaken = motion.vibration(found, moves)
    used, among = _still(found, samples, shaken[0])
    method = f"photon transfer of {len(used)} repeated frames{among}"
    if not used:
        used = _fitted(captures)
        method = f"what a sinusoid leaves of {len(used)} sets of fringes"
    dark = next((one for k, one in samples.items() if found[k].level == 0.0), None)
    curve = None
    if used:
        quantities, lost, curve = noise.photon_transfer(
            used, black, dark=dark, top=top, step=step, method=method
        )
        whole.take(quantities, lost)
    else:
        more = (
            "the same patterns twice or more, each in a folder, or fringes of four shifts or more"
        )
        for name in ("gain", "read noise"):
            whole.untold.append(Untold(name, "nothing was captured twice", more))
    level = {shot.level: shot for exposures in flats(found).values() for shot in exposures.values()}
    own = [samples[k] for k, shot in enumerate(found) if k in samples and shot in level.values()]
    if curve is not None and black is not None:
        whole.take(*fixed_pattern.between_pixels(own, black[0], curve.slope_dn, step))
    quantities, lost, light = response.response(found, captures, top)
    whole.take(quantities, lost)
    blur = spread.camera_blur(found, edge, top)
    whole.take(*blur)
    told = next(iter(blur[0]), None), next(iter(shaken[0]), None)
    quantities, lost, contrasts = spread.projector_blur(
        captures, *told, motion.of_codes(found, moves), top
    )
    whole.take(quantities, lost)
    level_dn = None if black is None else black[0]
    shaded = shading.camera_shading(evenly, level_dn, top)
    whole.take(*shaded)
    whole.take(*shading.white_shading(found, next(iter(shaded[0]), None), level_dn, top))
    whole.take(*shaken)
    whole.take(motion.flicker(moves))
    quantities, lost, followed = drift.drift(captures, hours, found, moves, level_dn, top)
    whole.take(quantities, lost)
    return Characterisation(
        folders=(*captures, *evenly),
        bit_depth=one.bit_depth,
        quantities=tuple(whole.quantities),
        untold=tuple(whole.untold),
        transfer=curve,
        curve=light,
        contrasts=tuple(contrasts),
        series=followed,
    )


def _black(
    found: Sequence[Shot],
    samples: Mapping[int, noise.Sample],
    given: float | None,
    stated: float,
    step: float,
) -> tuple[float, float] | None:
    """Return the black level and its deviation, DN; None where nothing tells it."""
    if given is not None:
        return given, 0.0
    dark = [k for k, shot in enumerate(found) if shot.level == 0.0]
    if dark:
        most = max(dark, key=lambda k: len(found[k].frames))
        return noise.black_level(found[most], samples.get(most), step)
    return (stated, 0.0) if stated > 0.0 else None


def _still(
    found: Sequence[Shot], samples: Mapping[int, noise.Sample], vibration: Sequence[Quantity]
) -> tuple[list[noise.Sample], str]:
    """Return samples of repeats; of the flat ones alone where fringes moved and these suffice.

    Words about the others go with them.
    """
    flat = [k for k in samples if found[k].level is not None]
    if not any(one.value > _SHAKEN_PX for one in vibration):
        return list(samples.values()), ""
    if len({found[k].level for k in flat}) >= _LEVELS:
        return [samples[k] for k in flat], ""
    return list(samples.values()), ", vibrating fringes among them (flat ones would tell more)"


def _fitted(captures: Mapping[str, Capture]) -> list[noise.Sample]:
    """Return samples of what sinusoids leave of fringe sets."""
    found = []
    for capture in captures.values():
        if capture.sequence.crosstalk is not None:
            continue
        for placed in capture.sequence.placed():
            if isinstance(placed.code, Fringes):
                steps = placed.code.steps(capture.sequence.size(placed.code.axis))
                frames = capture.frames[placed.frames.start : placed.frames.stop]
                sample = noise.of_fit(frames, steps, capture.top_dn)
                found += [] if sample is None else [sample]
    return found
