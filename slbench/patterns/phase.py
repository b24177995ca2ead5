"""Phase, unwrapping, and the noise they carry: the equations behind the decoder.

Relative phase for any number N >= 3 of shifts (thesis eq. 23 is N = 3):

    C = sum I_k cos(2 pi k / N),  S = sum I_k sin(2 pi k / N),
    phi = atan2(S, C) mod 2 pi,   b = 2 / N sqrt(C^2 + S^2),   a = mean I_k.

Any other list of shifts has weights of its own in these sums, by least squares.

Sequential active unwrapping (thesis eq. 24 and 26) takes the absolute phase of n fringes
to that of m fringes, pixel by pixel:

    Phi_m = 2 pi round((m / n Phi_n - phi_m) / 2 pi) + phi_m.

Noise.  To first order the phase error is -2 / (N b) sum dI_k sin(phi - 2 pi k / N).  For
independent noise whose variance alpha + beta I is linear in the signal (read noise and
shot noise), the sum of var_k sin^2 over the shifts gives

    var phi = 2 / (N b^2) [alpha + beta a - [N = 3] beta b cos(3 phi) / 2]:

shot noise leaves a third harmonic with three shifts and none with more.  The panel
coordinate is u = Phi W / (2 pi n) - 1/2, its standard deviation W / (2 pi n) times that of
the phase, provided that the fringe order is right (:mod:`slbench.patterns.fringes.wrong_orders`).

Noise never lessens a modulation on average.  2 C / N and 2 S / N have noise of a variance
2 v / N each, v being the mean variance of the frames, so that the measured b_hat is Rice
distributed (S. O. Rice, Bell System Technical Journal 24, 1945, sec. 3.10):

    E b_hat^2 = b^2 + 4 v / N,   E b_hat = sqrt(pi v / N) for b = 0.

The first is exact whatever the distribution of the noise.  Weights take it off
(:func:`squared_modulation_bias`), so that fringes that are lost weigh nothing.  A limit to the
ratio b_hat / sqrt(v) needs no correction, as its own distribution is known: noise alone passes a
limit m with the probability exp(-N m^2 / 4), 0.0012 for m = 3 and N = 3
(:func:`false_modulation_probability`).
"""

from math import exp, pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError

FloatArray = NDArray[np.float64]


def frame_weights(steps: FloatArray) -> FloatArray:
    """Return the least-squares weights of frames a + b cos(phi - e_k), (N, 3).

    They are those of b cos phi, b sin phi and a, scaled by N / 2, N / 2 and N, which makes them
    cos e_k, sin e_k and 1 for equal steps of a whole turn.

    Parameters
    ----------
    steps : (N,) float64
        Shifts e_k, rad, at least three distinct phases.
    """
    count = len(steps)
    design = np.stack([np.cos(steps), np.sin(steps), np.ones(count)], axis=1)
    gram = design.T @ design
    equal = np.diag([0.5 * count, 0.5 * count, float(count)])
    if np.abs(gram - equal).max() < 1e-9 * count:  # orthogonal: equal steps of a whole turn
        return design
    return np.asarray(design @ np.linalg.inv(gram) @ equal)


def relative_phase(
    frames: ArrayLike, steps: ArrayLike | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the relative phase of one set of N >= 3 shifted frames, by least squares.

    Parameters
    ----------
    frames : (N, V, U) array_like
        Frames a + b cos(phase - e_k).
    steps : (N,) array_like, optional
        The shifts e_k, rad; 2 pi k / N, k = 0..N-1 by default.

    Returns
    -------
    phase : (V, U) float64
        In [0, 2 pi).
    modulation : (V, U) float64
        Amplitude b of the fringes, in the unit of the frames.
    mean : (V, U) float64
        Mean a of the frames.

    Raises
    ------
    InputError
        For anything but a stack of at least three frames, or steps that are not one a frame.
    """
    stack = np.asarray(frames)
    if stack.ndim != 3 or stack.shape[0] < 3 or stack.size == 0:
        raise InputError("relative_phase: frames", "shape (N >= 3, V, U)", stack.shape)
    if steps is None:
        shifts = 2.0 * pi * np.arange(stack.shape[0]) / stack.shape[0]
        weights = np.stack([np.cos(shifts), np.sin(shifts), np.ones(len(shifts))], axis=1)
    else:
        shifts = np.asarray(steps, dtype=np.float64)
        if shifts.shape != (len(stack),):
            raise InputError("relative_phase: steps", f"shape ({len(stack)},)", shifts.shape)
        weights = frame_weights(shifts)
    cosine = np.zeros(stack.shape[1:])
    sine = np.zeros(stack.shape[1:])
    for frame, (c, s, _) in zip(stack, weights, strict=True):  # one by one: bounds the memory
        cosine += c * frame
        sine += s * frame
    phase = np.arctan2(sine, cosine)
    phase[phase < 0.0] += 2.0 * pi
    phase[phase >= 2.0 * pi] = 0.0  # a tiny negative angle rounds up to 2 pi
    modulation = 2.0 / stack.shape[0] * np.hypot(cosine, sine)
    if steps is None:
        return phase, modulation, stack.mean(axis=0, dtype=np.float64)
    return phase, modulation, np.tensordot(weights[:, 2] / len(weights), stack, axes=1)


def squared_modulation_bias(variance: ArrayLike, shifts: int) -> Any:
    """Return what noise adds to the mean of a squared modulation, b_hat^2 - b^2.

    Parameters
    ----------
    variance : array_like
        Variance v of one frame, DN^2, any shape; the mean over the frames where they differ.
    shifts : int
        Number N of frames.

    Returns
    -------
    ndarray or float
        4 v / N, of the shape and type of the variance.
    """
    return np.multiply(variance, 4.0 / shifts)


def false_modulation_probability(min_snr: float, shifts: int) -> float:
    """Return the probability that noise alone has a modulation of `min_snr` deviations or more.

    exp(-N m^2 / 4): the modulation of Gaussian noise is Rayleigh distributed.

    Parameters
    ----------
    min_snr : float
        Modulation over the standard deviation of one frame, m.
    shifts : int
        Number N of frames.
    """
    return exp(-0.25 * shifts * min_snr * min_snr)


def unwrap(
    phi: ArrayLike, fringes: float, reference: ArrayLike, reference_fringes: float
) -> FloatArray:
    """Return the absolute phase of `fringes` fringes from that of fewer (thesis eq. 26).

    Parameters
    ----------
    phi : array_like
        Relative phase in radians, any shape.
    fringes : float
        Its number of fringes, m.
    reference : array_like
        Absolute phase of the reference, of the same shape, in radians.
    reference_fringes : float
        The reference's number of fringes, n.

    Returns
    -------
    ndarray
        Phi_m = 2 pi round((m / n Phi_n - phi_m) / 2 pi) + phi_m.

    Raises
    ------
    InputError
        For fringe counts that are not positive.
    """
    for name, count in (("fringes", fringes), ("reference_fringes", reference_fringes)):
        if not (np.isfinite(count) and count > 0):
            raise InputError(f"unwrap: {name}", "a number > 0", count)
    phase = np.asarray(phi, dtype=np.float64)
    expected = fringes / reference_fringes * np.asarray(reference, dtype=np.float64)
    return 2.0 * pi * np.floor((expected - phase) / (2.0 * pi) + 0.5) + phase


def unwrap_spatially(phase: ArrayLike, mask: ArrayLike | None = None) -> FloatArray:
    """Unwrap one relative phase map by its neighbourhoods, most reliable pixels first.

    The baseline that active unwrapping is compared with: it needs one fringe set only, but
    takes a step of more than half a fringe for a smaller one, and knows the absolute phase up
    to a multiple of 2 pi, one for each connected region.  (Herraez et al., Applied Optics
    41(35), 2002; thesis ch. 2 [55, 57].  The work is scikit-image's.)

    Parameters
    ----------
    phase : (V, U) array_like
        Relative phase, rad.
    mask : (V, U) array_like of bool, optional
        True where the phase is valid; all finite pixels by default.

    Returns
    -------
    (V, U) float64
        Phase without jumps, NaN outside the mask.

    Raises
    ------
    InputError
        If the phase is no image, the mask of another shape, or nothing is valid.
    """
    from skimage.restoration import unwrap_phase

    try:
        relative = np.asarray(phase)
    except ValueError:  # rows of different lengths
        relative = np.empty(0)
    if relative.ndim != 2 or min(relative.shape) < 2 or relative.dtype.kind not in "uif":
        got = f"{relative.shape} {relative.dtype}"
        raise InputError("unwrap_spatially: phase", "real numbers (V, U), 2 x 2 or more", got)
    relative = relative.astype(np.float64)
    valid = np.isfinite(relative)
    if mask is not None:
        given = np.asarray(mask, dtype=bool)
        if given.shape != relative.shape:
            raise InputError("unwrap_spatially: mask", f"shape {relative.shape}", given.shape)
        valid &= given
    if not valid.any():
        raise InputError("unwrap_spatially: mask", "at least one valid pixel", "none")
    # A masked frame around the picture, as the library leaves the reliability of corner pixels to
    # whatever stands in memory, and a seed for its tie-breaking: same input, same output.
    framed = np.ma.masked_array(
        np.pad(np.where(valid, relative, 0.0), 1), mask=~np.pad(valid, 1, constant_values=False)
    )
    found = np.ma.getdata(unwrap_phase(framed, rng=0))[1:-1, 1:-1]
    return np.where(valid, found, np.nan)
