"""Codes without a closed form: a family that says what it shows is decoded by matching."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.patterns.base import (
    Axis,
    Code,
    Decoded,
    FloatArray,
    Found,
    Observed,
    Panel,
    Rule,
    Run,
    extent,
)
from slbench.patterns.matching.vectors import CodeVectors, Nuisance
from slbench.rig.optics.response import Response

#: Share of the places that may show what another part of the panel shows, and what is another part.
_MOST_REPEATED, _NEARBY = 0.95, 0.02
#: Where more than this share of the places may be, as many places a pixel are searched: half a
#: pixel from a column such frames may fit another part better.
_CONTESTED, _FINER = 0.1, 4


class MatchedCode(Code):
    """A code that is decoded by matching; a family needs no further line for it.

    It says which axis it codes, how many frames it has and what each shows
    (:meth:`Code.profile`).  Evidence: ``correlation``, normalised, with the best place;
    ``rival``, the correlation of the best other peak over it; ``fit_residual_dn``, what the best
    place leaves of the frames, DN.
    """

    @property
    def nuisance(self) -> Nuisance:
        """What is unknown of a pixel beside its place: a gain and an offset, by default."""
        return Nuisance()

    @property
    def blur_px(self) -> float:
        """Standard deviation of the blur that is matched with, px: that of lens and panel."""
        return 0.0

    def straightened(
        self, frames: NDArray[Any], panel: Panel, response: Response, saturation: float
    ) -> NDArray[Any]:
        """Return the frames themselves: they are matched with the light that the response makes."""
        return frames

    @classmethod
    def vectors(cls, run: Run, response: Response | None = None) -> CodeVectors:
        """Return the code vectors of a run along its one axis, as a projector shows them."""
        size = extent(run.panel, run.axes[0])
        profiles = [
            seen_of(
                [placed.code.profile(k, size) for k in range(len(placed.frames))],
                placed.code,
                response,
            )
            for placed in run.parts
        ]
        return vectors_of_parts(profiles, run.parts[0].code)

    @classmethod
    def decode_run(cls, run: Run, observed: Observed, found: Mapping[Axis, Found]) -> Decoded:
        """Decode the frames of the run by matching, near what coarser codes have found."""
        from slbench.patterns.matching.match import match

        if run.parts[0].code.varies(0) == "uv":
            return _decode_plane(run, observed)
        (axis,) = run.axes
        indices = [k for placed in run.parts for k in placed.frames]
        pixels = observed.pixels[indices]
        coarse = found.get(axis)
        near = None
        if coarse is not None:
            known = np.where(coarse.mask, coarse.coordinate, np.nan)
            near = (known, coarse.sigma)
        vectors = cls.vectors(run, observed.response)
        codes = tuple(placed.code for placed in run.parts)
        finer = _FINER if _repeated(codes, run.panel) > _CONTESTED else 1
        result = match(pixels, vectors, observed.noise, near, finer)
        mean: FloatArray = pixels.mean(axis=0, dtype=np.float64)
        modulation = 0.5 * result.gain
        noise = np.sqrt(observed.noise.variance(mean))
        lit = modulation >= np.maximum(observed.min_modulation, observed.min_snr * noise)
        known = result.sure & np.isfinite(result.sigma)
        evidence: dict[int, dict[str, Any]] = {}
        if observed.keep_evidence:
            evidence[run.parts[0].index] = {
                "correlation": result.correlation,
                "rival": result.rival,
                "fit_residual_dn": result.residual_dn,
            }
        return {
            axis: Found(
                coordinate=result.coordinate,
                sigma=result.sigma,
                modulation=modulation,
                mean=mean,
                mask=lit & known,
                evidence=evidence,
                dropped=np.select([~lit, ~known], [Rule.MODULATION, Rule.OTHER]).astype(np.uint8)
                if observed.keep_evidence
                else None,
            )
        }

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError for frames too few, or places that show the same and nothing coarser."""
        frames = sum(len(placed.frames) for placed in run.parts)
        if frames < 3:
            where = f"decode: parts[{run.parts[0].index}]"
            raise InputError(where, "at least 3 frames, to be decoded by matching", frames)
        if before or run.parts[0].code.varies(0) == "uv":
            return
        share = _repeated(tuple(placed.code for placed in run.parts), run.panel)
        if share > _MOST_REPEATED:
            where = f"decode: parts[{run.parts[0].index}]"
            expected = "places that differ, or a coarser code before"
            got = f"{100 * share:.0f} % that show what others show"
            raise InputError(where, expected, got)


@lru_cache(maxsize=64)
def _repeated(codes: tuple[Code, ...], panel: Panel) -> float:
    """Return the share of places that another part of the panel shows too, to half a pixel."""
    size = extent(panel, codes[0].axes[0])
    profiles = [seen_of([c.profile(k, size) for k in range(c.n_frames(panel))], c) for c in codes]
    vectors = vectors_of_parts(profiles, codes[0])
    first, last = vectors.cells()
    flat = vectors.basis().reshape(size, -1)
    unlike = 1.0 - flat @ flat.T
    place = np.arange(size)
    apart = np.abs(place[:, np.newaxis] - place)
    apart = np.minimum(apart, size - apart)  # a closed curve's ends are one place
    other = (apart > max(4, _NEARBY * size)) & (first[:, np.newaxis] != first)
    nearest = np.where(other, unlike, np.inf).min(axis=1)
    beside = unlike[place, np.minimum(last + 1, size - 1)], unlike[place, np.maximum(first - 1, 0)]
    # Half a pixel off a code vector changes by a quarter of what it does a pixel off; at edges by
    # all or nothing.
    step = np.where(vectors.edged(), 0.0, 0.25 * np.maximum(*beside))
    return float(np.mean(nearest <= step + 1e-6))


def _decode_plane(run: Run, observed: Observed) -> Decoded:
    """Decode images over the whole panel."""
    from slbench.patterns.matching.plane import match_plane

    pixels = observed.pixels[[k for placed in run.parts for k in placed.frames]]
    mean: FloatArray = pixels.mean(axis=0, dtype=np.float64)
    noise = np.sqrt(observed.noise.variance(mean))
    least = np.maximum(observed.min_modulation, observed.min_snr * noise)
    shown = np.concatenate(
        [
            seen_of(
                [p.code.image(k, run.panel) for k in range(len(p.frames))],
                p.code,
                observed.response,
            )
            for p in run.parts
        ]
    )
    result = match_plane(pixels, shown, observed.noise, 2.0 * least)
    modulation = 0.5 * result.gain
    good = modulation >= least
    evidence: dict[int, dict[str, Any]] = {}
    if observed.keep_evidence:
        evidence[run.parts[0].index] = {
            "correlation": result.correlation,
            "rival": result.rival,
            "fit_residual_dn": result.residual_dn,
        }
    return {
        axis: Found(
            coordinate=result.coordinate["uv".index(axis)],
            sigma=result.sigma["uv".index(axis)],
            modulation=modulation,
            mean=mean,
            mask=good & result.sure,
            evidence=evidence,
        )
        for axis in run.axes
    }


def seen_of(
    shown: Sequence[FloatArray], code: Code, response: Response | None = None
) -> FloatArray:
    """Return the light of pattern values (n, ...) as the lens shows it, by what is known of it."""
    from scipy.ndimage import gaussian_filter

    values = np.array(shown)
    if response is not None:
        values = response.light(np.clip(values, 0.0, 1.0))
    blur = code.blur_px if isinstance(code, MatchedCode) else 0.0
    if blur <= 0.0:
        return values
    axes = tuple(range(1, values.ndim))
    softened: FloatArray = gaussian_filter(values, blur, mode="nearest", axes=axes)
    return softened


def vectors_of_parts(profiles: Sequence[FloatArray], code: Code) -> CodeVectors:
    """Return the code vectors of the profiles (n, X) of each part."""
    nuisance = code.nuisance if isinstance(code, MatchedCode) else Nuisance()
    counts = [len(profile) for profile in profiles]
    parts = np.repeat(np.arange(len(counts)), counts)
    return CodeVectors(np.concatenate(profiles), parts, nuisance)
