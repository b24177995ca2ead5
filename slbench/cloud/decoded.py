"""What decoding a capture gives: panel coordinates, and points where its rig is known.

Beside them stands what they are judged by: by which rule pixels were dropped, residuals, the kind
of noise that deviations come from, how far rays miss each other, and warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.capture.doubts import exposure_doubt
from slbench.capture.manifest import manifest_doubts
from slbench.capture.noise import NoiseKind, noise_of
from slbench.cloud.calibrated import with_calibration
from slbench.cloud.files.write import point_fields
from slbench.cloud.gaps import RayGap, lost_points, ray_gap, rig_doubts
from slbench.cloud.triangulation import Meeting, PointCloud, triangulate
from slbench.core.errors import InputError, warn_user
from slbench.core.io import OutputFolder, write_exr, write_json, write_ply
from slbench.core.show.display import brief, length
from slbench.patterns import Decoder, NoiseModel, PhaseMap, Rule, decoded_by
from slbench.patterns.ripple import Ripple, ripple_rms_px, ripples
from slbench.rig.motion import Motion

if TYPE_CHECKING:
    from slbench.cloud.motion import AtRest

DECODED_FOLDER = OutputFolder(
    "decoded capture", ("phase.exr", "cloud.ply", "decode.json", "summary.png")
)


@dataclass(frozen=True, eq=False)
class Decoded:
    """A capture decoded, and triangulated where its rig is known.

    Parameters
    ----------
    capture : Capture
    phase : PhaseMap
        With its evidence.
    cloud : PointCloud or None
        None without a rig.
    ripple : tuple of Ripple
        Periodic errors of the coordinates, which the cloud's uncertainty holds.
    noise : NoiseModel
        What the deviations are predicted from.
    noise_kind : {"stated", "measured", "lower bound", "decoder"}
        Where it comes from; by "lower bound" it is rounding alone, by "decoder" it was not used.
    lost : dict
        Decoded pixels without a point, by reason (:func:`slbench.cloud.gaps.lost_points`).
    gap : RayGap or None
        Where both axes are coded and the rig is known.
    warnings : tuple of str
        What is probably wrong with the capture or its rig, a sentence each.
    motion : str
        What was taken out of the frames, which are those of the capture then; empty for none.
    """

    capture: Capture
    phase: PhaseMap
    cloud: PointCloud | None
    ripple: tuple[Ripple, ...]
    noise: NoiseModel
    noise_kind: NoiseKind
    lost: dict[str, int]
    gap: RayGap | None
    warnings: tuple[str, ...]
    motion: str = ""

    __repr__ = brief

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of the whole, for JSON."""
        cloud = self.cloud
        return {
            "patterns": self.capture.sequence.name,
            "frames": len(self.capture.frames),
            "valid_pixels": int(np.count_nonzero(self.phase.mask)),
            "points": None if cloud is None else len(cloud),
            "predicted_sigma_mm": float(np.median(cloud.sigma_total_mm)) if cloud else None,
            "predicted_u_mm": float(np.nanmedian(cloud.u_total_mm)) if cloud else None,
            "ripple": [found.to_dict() for found in self.ripple],
            **self._exposures(),
            "noise": self.noise_kind,
            "noise_model": None if self.noise_kind == "decoder" else asdict(self.noise),
            "dropped": self.dropped,
            "order_residual": self._residuals("order_residual"),
            "fit_residual_dn": self._residuals("fit_residual_dn"),
            "ray_gap": None
            if self.gap is None
            else {"mm": _quantiles(self.gap.mm), "deviations": _quantiles(self.gap.deviations)},
            "points_dropped": self.lost,
            "warnings": list(self.warnings),
            **({"motion": self.motion} if self.motion else {}),
        }

    def rows(self) -> list[tuple[str, str]]:
        """Return name and value of what people read first."""
        kind = {"measured": " (measured noise)", "lower bound": " (lower bound: rounding alone)"}
        values = self.to_dict()
        names = ("patterns", "frames", "valid_pixels", "points")
        rows = [(name, "-" if values[name] is None else str(values[name])) for name in names]
        sigma = values["predicted_sigma_mm"]
        rows.append(
            (
                "predicted_sigma_mm",
                "-" if sigma is None else f"{sigma}{kind.get(self.noise_kind, '')}",
            )
        )
        rows.append(("predicted_u_mm", "-" if sigma is None else str(values["predicted_u_mm"])))
        rows += [(f"ripple of {found.cause}, {found.axis}", str(found)) for found in self.ripple]
        rows += [
            (f"valid_pixels at {one['ms']:.4g} ms", str(one["valid_pixels"]))
            for one in values.get("exposures", ())
        ]
        rows.append(("noise", self.noise_kind))
        if self.motion:
            rows.append(("motion", self.motion))
        dropped = [f"{name} {count}" for name, count in self.dropped.items() if count]
        rows.append(("dropped", ", ".join(dropped) or "none"))
        lost = [f"{name} {count}" for name, count in self.lost.items() if count]
        if lost:
            rows.append(("points_dropped", ", ".join(lost)))
        for table in values["order_residual"]:
            if table["beyond_quarter_turn"] is not None:
                share = f"{100 * table['beyond_quarter_turn']:.3g} % beyond a quarter turn"
                rows.append((f"order_residual of parts[{table['part']}]", share))
        for table in values["fit_residual_dn"]:
            if table["p50"] is not None:
                median = f"{table['p50']:.3g} DN (median)"
                rows.append((f"fit_residual of parts[{table['part']}]", median))
        if self.gap is not None:
            mm, own = (float(np.median(np.abs(x))) for x in (self.gap.mm, self.gap.deviations))
            rows.append(("ray_gap", f"{length(mm)}, {own:.3g} deviations (median)"))
        return rows

    def _exposures(self) -> dict[str, Any]:
        """Return from which exposure measured pixels come, where there are several."""
        bracket = self.capture.bracket
        if bracket is None:
            return {}
        chosen = bracket.chosen[self.phase.mask]
        counts = np.bincount(chosen, minlength=len(bracket.times_s)).tolist()
        tables = zip(bracket.times_s, counts, strict=True)
        return {"exposures": [{"ms": 1e3 * time, "valid_pixels": n} for time, n in tables]}

    @property
    def dropped(self) -> dict[str, int]:
        """Pixels without a coordinate, by rule."""
        assert self.phase.dropped is not None
        counts = np.bincount(self.phase.dropped.ravel(), minlength=len(Rule))
        return {rule.name.lower(): int(counts[rule]) for rule in Rule if rule != Rule.KEPT}

    @property
    def grey(self) -> NDArray[np.float64]:
        """Grey value of every point, DN: of the lit frame, or the mean of the last frames."""
        if self.cloud is None:
            return np.empty(0)
        u, v = self.cloud.pixels.T
        return np.asarray(grey_image(self.capture, self.phase)[v, u], dtype=np.float64)

    def _residuals(self, name: str) -> list[dict[str, Any]]:
        """Return the quantiles of one kind of evidence, a table for every part that has it.

        They are of the pixels that have light, those included whose order is not believed.
        """
        assert self.phase.dropped is not None
        lit = ~np.isin(self.phase.dropped, (Rule.SATURATED, Rule.MODULATION, Rule.BIT))
        found = []
        for placed in self.capture.sequence.placed():
            values = self.phase.evidence.get(placed.index, {}).get(name)
            if values is None:
                continue
            own = values[lit & np.isfinite(values)].astype(np.float64)
            table = {"part": placed.index, "axis": placed.code.axes[0], **_quantiles(own)}
            if name == "order_residual":
                beyond = np.abs(own) > 0.25
                table["beyond_quarter_turn"] = float(beyond.mean()) if len(own) else None
            found.append(table)
        return found

    def save(
        self,
        folder: str | Path,
        parameters: Mapping[str, Any],
        files: Mapping[str, Callable[[Path], None]] | None = None,
    ) -> None:
        """Write the maps, the cloud and the numbers; nothing appears until all are complete.

        Parameters
        ----------
        folder : path
            For ``phase.exr`` (``modulation``, ``mean``, ``mask`` and, by axis, ``panel.u`` and
            ``sigma.u``, px; and, where nothing tells fringes apart, ``relative.u.0``, rad, of every
            set in order of projection), ``cloud.ply`` (if there are points; with
            ``sigma`` and ``u``, mm, normals, and ``grey``, DN), ``decode.json`` and
            ``provenance.json``.
        parameters : mapping
            For the provenance.
        files : mapping of str to callable, optional
            What is to stand beside them: ``summary.png``, and what writes it.
        """
        cloud = self.cloud
        with DECODED_FOLDER.writing(folder, parameters, None) as temporary:
            self.write_maps(temporary / "phase.exr")
            if cloud:
                fields = point_fields(cloud, self.grey)
                write_ply(temporary / "cloud.ply", cloud.points, fields)
            for name, write in (files or {}).items():
                write(temporary / name)
            write_json(temporary / "decode.json", self.to_dict())

    def write_maps(self, path: Path) -> None:
        """Write coordinates and what belongs to them as EXR, as :meth:`save` names them."""
        phase = self.phase
        channels = {
            "modulation": phase.modulation,
            "mean": phase.mean,
            "mask": phase.mask,
            **{f"panel.{axis}": values for axis, values in phase.coordinate.items()},
            **{f"sigma.{axis}": values for axis, values in phase.sigma.items()},
            **{
                f"relative.{axis}.{k}": values
                for axis, sets in phase.relative.items()
                for k, (_, values) in enumerate(sets)
            },
        }
        single = {name: values.astype(np.float32) for name, values in channels.items()}
        write_exr(path, single)


def grey_image(capture: Capture, phase: PhaseMap) -> NDArray[Any]:
    """Return the grey values of what was measured, (V, U), DN.

    They are those of the lit frame, or the mean of the last frames where there is none.
    """
    lit = capture.sequence.lit_frame
    return capture.evened(phase.mean if lit is None else capture.frames[lit])


def _quantiles(values: NDArray[Any]) -> dict[str, float | None]:
    """Return the 5th, 50th and 95th percentile, None where there is nothing."""
    names, shares = ("p5", "p50", "p95"), (5.0, 50.0, 95.0)
    finite = values[np.isfinite(values)]
    if not len(finite):
        return dict.fromkeys(names)
    found = np.percentile(finite, shares)
    return {name: float(value) for name, value in zip(names, found, strict=True)}


def decode_capture(
    capture: Capture,
    *,
    min_modulation: float | None = None,
    max_order_residual: float | None = None,
    decoder: Decoder | None = None,
    meeting: Meeting = "ray",
    motion: Motion | Literal["estimated"] | None = None,
    where: object = "capture",
) -> Decoded:
    """Decode a capture with its evidence, and triangulate it where its rig is known.

    Where the capture does not state its noise and the frames measure it, deviations come from the
    measured one.  Which pixels are valid does not: what a sinusoid leaves of the frames may be a
    projector's response, which is no noise.

    Parameters
    ----------
    capture : Capture
    min_modulation : float, optional
        Least modulation of a valid pixel, DN; as :meth:`Capture.decode` takes it.
    max_order_residual : float, optional
        Largest residual of a fringe order that is believed, turns; the sequence's by default.
    decoder : callable, optional
        Decodes the frames instead of slbench (:data:`slbench.patterns.Decoder`): it has its own
        limits, and no evidence but its mask and deviations.
    meeting : {"ray", "nearest"}
        Where the point of two coded axes is, as of :func:`triangulate`.
    motion : Motion or "estimated", optional
        Of all that is seen, to be taken out of the frames (:mod:`slbench.cloud.motion`); about the
        world's origin where it has no centre.
    where : object
        What to call the capture in a warning, its folder.

    Returns
    -------
    Decoded

    Raises
    ------
    InputError
        For motion that cannot be taken out (:func:`slbench.cloud.motion.at_rest`).

    Warns
    -----
    InputWarning
        If nearly all pixels are saturated or dark, the frames are not those of the patterns, or
        the rays of the rig do not meet; :attr:`Decoded.warnings` has the same sentences.
    """
    resting, moved = None, ""
    rounding = capture.least_noise  # of the frames as they were taken
    if motion is not None:
        if decoder is not None:
            raise InputError("motion", "none beside a decoder of one's own", "one")
        resting, moved = _at_rest(capture, motion)
        capture = resting.capture

    def decoded_with(noise: NoiseModel, **options: Any) -> PhaseMap:
        own = replace(capture, noise=noise)
        shots = own if resting is None else replace(resting, capture=own)
        return shots.decode(
            min_modulation=min_modulation,
            max_order_residual=max_order_residual,
            keep_evidence=True,
            **options,
        )

    noise = rounding
    kind: NoiseKind = "decoder"
    if decoder is not None:
        phase = _decoded_by(decoder, capture)
    else:
        phase = decoded_with(rounding)
        noise, kind = noise_of(capture, phase)
        if kind == "lower bound":
            noise = rounding
    exposure = exposure_doubt(capture, phase)
    doubts = [exposure] if exposure else []
    if not exposure and decoder is None:
        doubts = manifest_doubts(capture.apart(), phase)
    if kind == "measured":
        phase = decoded_with(noise, min_snr=0.0)
    ripple = ripples(phase, capture.sequence)
    cloud, gap, lost = None, None, {}
    if capture.rig is not None:
        cloud = triangulate(capture.rig, phase, meeting)
        cloud = cloud.with_steady(ripple_rms_px(ripple))
        if capture.rig_covariance is not None:
            cloud = with_calibration(cloud, capture.rig, phase, capture.rig_covariance, meeting)
        gap = ray_gap(capture.rig, phase, cloud)
        lost = lost_points(capture.rig, phase, cloud)
        doubts += rig_doubts(phase, lost, gap)
    for doubt in doubts:
        warn_user(where, doubt)
    return Decoded(
        capture, phase, cloud, ripple, noise, kind, lost, gap, tuple(doubts), motion=moved
    )


def _at_rest(capture: Capture, motion: Motion | Literal["estimated"]) -> tuple[AtRest, str]:
    """Return a capture as if nothing had moved, and what has."""
    from slbench.cloud.motion import at_rest, estimated_motion  # SciPy's, for few captures

    if isinstance(motion, Motion):
        return at_rest(capture, motion.at), str(motion)
    found = estimated_motion(capture)
    return at_rest(capture, found.motion.at), f"{found}, estimated"


def _decoded_by(decoder: Decoder, capture: Capture) -> PhaseMap:
    """Return what a decoder of the user's own makes of a capture's frames."""
    shots = capture.apart()
    phase = decoded_by(decoder, shots.frames, shots.sequence)
    dropped = np.where(phase.mask, Rule.KEPT, Rule.OTHER).astype(np.uint8)
    return replace(phase, relative={}, evidence={}, dropped=dropped)
