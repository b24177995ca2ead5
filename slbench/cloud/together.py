"""What decoding the captures of several cameras and projectors gives: a map each, one cloud.

Three ways lead to the cloud.  *Joint* triangulation takes all rays of all devices, which must be
calibrated.  *Stereo on phase* takes those of two cameras at places of equal code; *blocks* compares
the grey values of two cameras and decodes nothing.  The latter two need no calibrated projector.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from slbench.capture.captures import Captures, folder_names, pair_name
from slbench.cloud.decoded import Decoded, decode_capture, grey_image
from slbench.cloud.joint import JointCloud, triangulate_jointly
from slbench.core.errors import InputError, located, warn_user
from slbench.core.io import OutputFolder, write_json, write_ply
from slbench.core.show.display import brief, length, share
from slbench.patterns import Decoder
from slbench.patterns.ripple import ripple_rms_px
from slbench.rig import Pair

#: How two cameras are matched where no projector is calibrated.
Stereo = Literal["phase", "blocks"]
#: Deviations that views disagree by (median) which noise and a usual calibration do not explain;
#: share of what two views see both of that agrees, below which they are not of one world.
_DISAGREE, _AGREE = 5.0, 0.5
_ENTRIES = ("cloud.ply", "decode.json", "summary.png")


@dataclass(frozen=True, eq=False)
class DecodedRig:
    """Captures decoded, and triangulated together where their rig is known.

    Parameters
    ----------
    captures : Captures
    decoded : mapping of Pair to Decoded
        One a pair; none where blocks were matched.
    cloud : JointCloud or None
        None without a rig.
    way : {"joint", "phase", "blocks"}
        How the cloud was made.
    warnings : tuple of str
        What is probably wrong with the rig, a sentence each.
    """

    captures: Captures
    decoded: Mapping[Pair, Decoded]
    cloud: JointCloud | None
    way: Literal["joint", "phase", "blocks"]
    warnings: tuple[str, ...] = ()

    __repr__ = brief

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of the whole, for JSON."""
        cloud = self.cloud
        values: dict[str, Any] = {
            "way": self.way,
            "points": None if cloud is None else len(cloud),
            "predicted_sigma_mm": float(np.median(cloud.sigma_total_mm)) if cloud else None,
            "predicted_u_mm": float(np.nanmedian(cloud.u_total_mm)) if cloud else None,
        }
        if cloud is not None:
            names = list(cloud.shapes)
            counts = np.bincount(cloud.rays, minlength=1)
            known = cloud.chi_square[np.isfinite(cloud.chi_square)]
            values |= {
                "points_by_rays": {str(n): int(k) for n, k in enumerate(counts) if k},
                "points_by_camera": {
                    name: int(np.count_nonzero(cloud.camera == k)) for k, name in enumerate(names)
                },
                "chi_square": float(np.mean(known)) if len(known) else None,
                "disagreement": [
                    {"of": pair_name(one), "with": pair_name(other), "deviations": scale}
                    for (one, other), scale in cloud.disagreement.items()
                ],
            }
        values["pairs"] = {pair_name(pair): one.to_dict() for pair, one in self.decoded.items()}
        return values | {"warnings": list(self.warnings)}

    def rows(self) -> list[tuple[str, str]]:
        """Return name and value of what people read first."""
        values = self.to_dict()
        rows = []
        for name, one in values["pairs"].items():
            rows.append((name, f"{one['valid_pixels']} valid pixels, noise {one['noise']}"))
        rows.append(("points", "-" if self.cloud is None else str(len(self.cloud))))
        if self.cloud is None:
            return rows
        by_rays = values["points_by_rays"].items()
        rows.append(("points by rays", ", ".join(f"{n}: {count}" for n, count in by_rays)))
        cameras = values["points_by_camera"].items()
        rows.append(("points by camera", ", ".join(f"{n}: {count}" for n, count in cameras)))
        if len(self.cloud):
            rows.append(("predicted sigma", length(values["predicted_sigma_mm"])))
            rows.append(("predicted u", length(values["predicted_u_mm"])))
        if values["chi_square"] is not None:
            rows.append(("reduced chi-square", f"{values['chi_square']:.3g}"))
        for one in values["disagreement"]:
            said = f"{one['deviations']:.3g} deviations"
            rows.append((f"{one['of']} differs from {one['with']} by", said))
        return rows

    @property
    def grey(self) -> dict[str, Any]:
        """Grey values of each camera's picture, (V, U), DN: its first pair's."""
        found: dict[str, Any] = {}
        for pair, capture in self.captures.captures.items():
            if pair in self.decoded:
                own = grey_image(self.decoded[pair].capture, self.decoded[pair].phase)
            else:
                own = np.mean([capture.evened(frame) for frame in capture.frames], axis=0)
            found.setdefault(pair.camera, own)
        return found

    def save(
        self,
        folder: str | Path,
        parameters: Mapping[str, Any],
        files: Mapping[str, Callable[[Path], None]] | None = None,
    ) -> None:
        """Write a folder of maps a pair, the cloud and the numbers; all or nothing.

        Parameters
        ----------
        folder : path
            For ``PAIR/phase.exr`` as :meth:`Decoded.save` has it, ``cloud.ply`` (with ``sigma``,
            ``u``, normals, ``grey``, ``rays``, ``camera`` and ``residual``), ``decode.json`` and
            ``provenance.json``.
        parameters : mapping
            For the provenance.
        files : mapping of str to callable, optional
            What is to stand beside them: ``summary.png``, and what writes it.
        """
        with folder_for(self.captures).writing(folder, parameters, None) as temporary:
            for pair, one in self.decoded.items():
                own = temporary / pair_name(pair)
                own.mkdir()
                one.write_maps(own / "phase.exr")
            if self.cloud:
                fields = self.cloud.fields(self.grey)
                write_ply(temporary / "cloud.ply", self.cloud.points, fields)
            for name, write in (files or {}).items():
                write(temporary / name)
            write_json(temporary / "decode.json", self.to_dict())


def folder_for(captures: Captures) -> OutputFolder:
    """Return the kind of folder that decoded captures are written to."""
    return OutputFolder("decoded captures", (*_ENTRIES, *folder_names(captures).values()))


def decode_captures(
    captures: Captures,
    *,
    stereo: Stereo | None = None,
    min_modulation: float | None = None,
    max_order_residual: float | None = None,
    decoder: Decoder | None = None,
    depth_mm: tuple[float, float] | None = None,
    where: object = "captures",
) -> DecodedRig:
    """Decode the captures of several pairs, and triangulate them together.

    Parameters
    ----------
    captures : Captures
    stereo : {"phase", "blocks"}, optional
        Match two cameras; by default all rays are triangulated jointly, or two cameras by phase
        where their rig has no projectors.
    min_modulation, max_order_residual, decoder
        As for :func:`~slbench.cloud.decoded.decode_capture`.
    depth_mm : (float, float), optional
        Depths that blocks are searched in, as of :func:`~slbench.cloud.blocks.match_blocks`.
    where : object
        What to call the captures in a warning, their folder.

    Raises
    ------
    InputError
        Unless stereo has two cameras, one projector that they both see, and their rig.

    Warns
    -----
    InputWarning
        As :func:`~slbench.cloud.decoded.decode_capture` for each pair, and where views disagree by
        much more than their noise; :attr:`DecodedRig.warnings` has the latter.
    """
    rig = captures.rig
    if stereo is None and rig is not None and not rig.projectors:
        stereo = "phase"
    if stereo is not None:
        _check_stereo(captures)
    if depth_mm is not None and stereo != "blocks":
        raise InputError("depth_mm", "none where no blocks are matched", depth_mm)
    if stereo == "blocks":
        for name, value in (
            ("min_modulation", min_modulation),
            ("max_order_residual", max_order_residual),
            ("decoder", decoder),
        ):
            if value is not None:
                raise InputError(name, "none where blocks are matched: nothing is decoded", value)
        from slbench.cloud.blocks import match_blocks

        assert rig is not None  # checked
        frames = {
            pair.camera: np.stack([one.evened(frame) for frame in one.frames])
            for pair, one in captures.captures.items()
        }
        return DecodedRig(captures, {}, match_blocks(rig, frames, depth_mm), "blocks")
    decoded = {}
    for pair, capture in captures.captures.items():
        # Each alone too, where its projector is of use: what is wrong with one pair is told.
        own = replace(capture, rig=None, rig_covariance=None) if stereo else capture
        with located(pair_name(pair)):
            decoded[pair] = decode_capture(
                own,
                min_modulation=min_modulation,
                max_order_residual=max_order_residual,
                decoder=decoder,
                where=f"{where}: {pair_name(pair)}",
            )
    phases = {pair: one.phase for pair, one in decoded.items()}
    if rig is None:
        return DecodedRig(captures, decoded, None, "joint")
    if stereo == "phase":
        from slbench.cloud.stereo import triangulate_stereo

        cloud = triangulate_stereo(rig, {pair.camera: one for pair, one in phases.items()})
        way: Literal["joint", "phase"] = "phase"
    else:
        steady = {pair: ripple_rms_px(one.ripple) for pair, one in decoded.items()}
        cloud, way = triangulate_jointly(rig, phases).with_shared(steady), "joint"
    warnings = tuple(view_doubts(cloud))
    for doubt in warnings:
        warn_user(where, doubt)
    return DecodedRig(captures, decoded, cloud, way, warnings)


def view_doubts(cloud: JointCloud) -> list[str]:
    """Question views of one point that disagree by more than noise and usual calibrations do."""
    found: list[str] = []
    told: set[frozenset[Pair]] = set()
    for (one, other), scale in cloud.disagreement.items():
        if frozenset((one, other)) in told:
            continue
        agreeing = cloud.agreeing.get((one, other), 1.0)
        names = f"{pair_name(one)} and {pair_name(other)}"
        if agreeing < _AGREE or scale > _DISAGREE:
            told.add(frozenset((one, other)))
        if agreeing < _AGREE:
            found.append(
                f"{names} agree on {share(agreeing)} of what both see: the calibration of one, "
                "cameras that were mixed up, or wrong fringe orders?"
            )
        elif scale > _DISAGREE:
            found.append(
                f"{names} disagree by {scale:.3g} predicted deviations (median): the calibration "
                "of one, or something moved between their frames?"
            )
    return found


def _check_stereo(captures: Captures) -> None:
    if captures.rig is None:
        raise InputError("stereo", "the rig of two cameras", "none")
    if len(captures.cameras) != 2:
        expected = "two cameras (--cameras chooses them)"
        raise InputError("stereo", expected, ", ".join(captures.cameras))
    projectors = list(dict.fromkeys(pair.projector for pair in captures))
    if len(projectors) != 1:
        expected = "one projector that both cameras see (--projectors chooses it)"
        raise InputError("stereo", expected, ", ".join(projectors))
