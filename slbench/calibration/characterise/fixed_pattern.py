"""What differs from pixel to pixel of a flat frame: PRNU and DSNU.

What is left between pixels of the mean of a flat frame, without its shading and its temporal noise,
is DSNU in the dark and grows with the signal by PRNU (EMVA Standard 1288 release 4.0, 8).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.characterise.noise import SMOOTH, Sample
from slbench.calibration.characterise.quantity import BLOCKS, Quantity, Untold, blocks, jackknife

Array = NDArray[np.float64]

#: Radius of the high pass, px, and how many times the usual variance of a block is texture.
_PASS, _TEXTURE = 2.0, 2.0


def between_pixels(
    samples: Sequence[Sample], black: float, slope: float, step: float
) -> tuple[list[Quantity], list[Untold]]:
    """Measure PRNU and DSNU by the means of flat frames.

    Parameters
    ----------
    samples : sequence of Sample
        Of flat frames that were repeated.
    black : float
        Black level, DN.
    slope : float
        DN an electron.
    step : float
    """
    from scipy.ndimage import binary_dilation, gaussian_filter

    more = "white and black frames of a smooth plane, four times or more"
    if not samples:
        return [], [Untold(name, "no flat frame was repeated", more) for name in ("PRNU", "DSNU")]
    impulse = np.zeros((41, 41))
    impulse[20, 20] = 1.0
    kept_share = float(((impulse - gaussian_filter(impulse, _PASS)) ** 2).sum())
    tables = []
    # Rounding is a fixed pattern of its own where noise is little beside a step.
    loud = [sample for sample in samples if _noise_dn(sample) >= SMOOTH * step]
    for sample in loud:
        smooth = gaussian_filter(sample.mean, _PASS)
        good = sample.good & ~binary_dilation(~sample.good, iterations=int(3 * _PASS))
        edge = int(4 * _PASS)
        inner = np.zeros_like(good)
        inner[edge:-edge, edge:-edge] = True
        good &= inner
        number = blocks(good.shape)[good]
        wave = (sample.mean - smooth)[good].astype(np.float64)
        size = BLOCKS**2
        count = np.bincount(number, minlength=size)
        # The mean of a block is its curvature.
        wave -= (np.bincount(number, wave, size) / np.maximum(count, 1))[number]
        squares = np.bincount(number, wave**2, size) / kept_share
        temporal = np.bincount(number, sample.variance[good], size) / (sample.freedom + 1)
        signal = np.bincount(number, (smooth[good] - black) ** 2, size)
        tables.append(np.stack([count, squares, temporal, signal], axis=1))
    if not tables:
        why = "the flat frames' noise is less than rounding shows"
        return [], [Untold(name, why, "more gain or more bits") for name in ("PRNU", "DSNU")]
    table = np.stack(tables, axis=1)  # (T, levels, 4)
    table = _without_texture(table)
    if np.count_nonzero(table[..., 0].sum(axis=1)) < 8:
        why = "the flat frames show no smooth plane"
        return [], [Untold(name, why, more) for name in ("PRNU", "DSNU")]
    signals = np.sqrt(table[..., 3].sum(axis=0) / np.maximum(table[..., 0].sum(axis=0), 1.0))
    several = len(loud) > 1 and np.ptp(signals) > 0.3 * max(signals.max(), 1e-9)

    def estimate(sums: Array) -> Array:
        count = np.maximum(sums[:, 0], 1.0)
        variance = (sums[:, 1] - sums[:, 2]) / count
        square = sums[:, 3] / count
        if not several:
            one = int(np.argmax(square))
            return np.array([variance[one] / max(square[one], 1e-9), 0.0])
        # A variance of between pixels scatters by all of it.
        root = np.sqrt(count) / np.maximum(sums[:, 1] / count, 1e-9)
        design = np.stack([root * square, root], axis=1)
        return np.asarray(np.linalg.lstsq(design, root * variance, rcond=None)[0])

    found = jackknife(table, estimate)
    fewest = min(sample.freedom for sample in loud) + 1
    text = f"{len(loud)} flat frames, means of {fewest} repeats or more"
    quantities, missing = [], []
    wanted = (
        ("PRNU", "of the signal", 1.0, ("detector", "prnu"), "the surface's texture counts too"),
        ("DSNU", "electrons", 1.0 / slope, ("detector", "dsnu_e"), ""),
    )
    for k, (name, unit, scale, key, note) in enumerate(wanted):
        if k == 1 and not several:
            why = "noise of all flat frames but one brightness is hidden by rounding"
            missing.append(Untold(name, why, more))
            continue
        square, half = found.value[k], found.half_width[k]
        low, high = max(square - half, 0.0), max(square + half, 0.0)
        if k == 0 and signals.max() < 10.0 * step:
            missing.append(Untold(name, "the flat frames are dark", more))
        elif low == 0.0:
            limit = scale * np.sqrt(high)
            why = f"too little beside noise and rounding: at most {limit:.3g} {unit}"
            missing.append(Untold(name, why, more))
        else:
            value, low, high = (scale * float(np.sqrt(x)) for x in (square, low, high))
            quantities.append(
                Quantity(
                    name=name,
                    value=value,
                    low=low,
                    high=high,
                    unit=unit,
                    method=text,
                    key=key,
                    note=note,
                )
            )
    return quantities, missing


def _noise_dn(sample: Sample) -> float:
    return float(np.sqrt(np.mean(sample.variance[sample.good]))) if sample.good.any() else 0.0


def _without_texture(table: Array) -> Array:
    """Return sums over blocks without those that hold edges or texture, (T, levels, 4)."""
    kept = table.copy()
    for level in range(table.shape[1]):
        count = kept[:, level, 0]
        full = count > 0.5 * max(count.max(), 1.0)
        spatial = kept[:, level, 1] / np.maximum(count, 1.0)
        usual = np.median(spatial[full]) if full.any() else 0.0
        # Shading of the light makes brighter blocks differ more, by less than this.
        bad = (spatial > _TEXTURE * usual) | ~full
        kept[bad] = 0.0
    return kept
