"""Focus stacks as photographers take them, with a known all-in-focus picture.

Layers from the back to the front, each with a cover, a picture and a depth.  A frame is what a
thin lens makes of them: every layer is blurred by the disc of its depth, cover and picture alike,
and laid over those behind it.  Focusing magnifies (the further from the middle frame, the more),
the hand shakes, an automatic exposure gives each frame a gain of its own, and the camera adds
noise.  The background lies behind the last focus setting: no frame shows it sharply, and the best
that there is of it is its least blurred.
"""

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True, kw_only=True)
class PhotographStack:
    """What was photographed: frames (P, V, U), and the picture that a fusion should be."""

    frames: np.ndarray
    truth: np.ndarray
    #: Where the truth is plain: no texture, nothing to choose by.
    plain: np.ndarray


def photograph_stack(
    frames=9,
    shape=(256, 320),
    blur_px=0.7,
    breathing=0.004,
    shake_px=1.0,
    gains=0.15,
    noise_dn=1.2,
    seed=0,
):
    """Return a stack of 8 bit photographs.

    `blur_px` is the radius of the disc a frame of defocus, `breathing` the change of scale a
    frame, `shake_px` and `gains` (of the logarithm) are deviations between frames.
    """
    rng = np.random.default_rng(seed)
    middle = frames // 2
    margin = 24  # what magnification and shake bring in from beyond the border
    size = (shape[0] + 2 * margin, shape[1] + 2 * margin)
    layers = _layers(size, frames, rng)
    warps, taken = [], []
    for p in range(frames):
        scale = 1.0 + breathing * (p - middle)
        shift = rng.normal(0.0, shake_px, 2) if p != middle else np.zeros(2)
        gain = np.exp(rng.normal(0.0, gains)) if p != middle else 1.0
        image = _composed(layers, [blur_px * abs(p - depth) for _, _, depth in layers])
        centre = np.array([size[1], size[0]]) / 2
        warp = np.array(
            [
                [scale, 0.0, (1 - scale) * centre[0] + shift[0]],
                [0.0, scale, (1 - scale) * centre[1] + shift[1]],
            ]
        )
        warps.append(warp)
        if p != middle:
            image = cv2.warpAffine(
                image, warp, size[::-1], flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT
            )
        image = gain * image + rng.normal(0.0, noise_dn, size)
        taken.append(image[margin:-margin, margin:-margin])
    nearest = [blur_px * min(abs(p - depth) for p in range(frames)) for _, _, depth in layers]
    truth = _composed(layers, nearest)[margin:-margin, margin:-margin]
    stack = np.clip(np.rint(taken), 0, 255).astype(np.uint8)
    return PhotographStack(frames=stack, truth=truth, plain=_plain(truth))


def _layers(size, frames, rng):
    """Background out of reach, a textured slope in slices, and plain and textured pieces."""
    v, u = np.mgrid[0 : size[0], 0 : size[1]].astype(np.float64)
    everywhere = np.ones(size)
    layers = [(everywhere, 105.0 + 22.0 * _texture(size, rng, 1.6), frames + 5.0)]
    ground = 120.0 + 25.0 * _texture(size, rng, 0.9)
    slices = 4 * frames
    top, bottom = 0.45 * size[0], float(size[0])
    for k in range(slices):  # a slope rises towards the viewer
        edge = top + (bottom - top) * k / slices
        depth = (frames - 1.0) * (1.0 - (k + 0.5) / slices)
        layers.append((np.clip(v - edge + 0.5, 0.0, 1.0), ground, depth))
    for k in range(7):
        centre = rng.uniform(0.15, 0.85, 2) * size
        radius = rng.uniform(0.06, 0.14) * min(size)
        cover = np.clip(radius - np.hypot(v - centre[0], u - centre[1]) + 0.5, 0.0, 1.0)
        picture = rng.uniform(50.0, 170.0) * everywhere
        if k % 2:
            picture = picture + 18.0 * _texture(size, rng, 0.7)
        layers.append((cover, np.clip(picture, 10.0, 190.0), rng.uniform(0.5, frames - 1.5)))
    return [layers[0], *sorted(layers[1:], key=lambda layer: -layer[2])]


def _texture(size, rng, power):
    """Noise of a spectrum of amplitudes 1 / f ** power, deviation 1, as of natural pictures."""
    fv, fu = np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])[None]
    amplitude = np.hypot(fv, fu)
    amplitude[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.normal(size=size)) / amplitude**power
    image = np.fft.irfft2(spectrum, size)
    return np.clip((image - image.mean()) / image.std(), -2.5, 2.5)


def _composed(layers, radii):
    image = np.zeros(layers[0][0].shape)
    for (cover, picture, _), radius in zip(layers, radii, strict=True):
        alpha = _blurred(cover, radius)
        image = image * (1.0 - alpha) + _blurred(cover * picture, radius)
    return image


def _blurred(image, radius):
    """Return an image convolved with a disc, its edge smoothed by a pixel."""
    if radius < 0.1:
        return image
    reach = int(np.ceil(radius + 1.0))
    grid = np.arange(-reach, reach + 1.0)
    sub = (np.arange(8) - 3.5) / 8
    fine = (grid[:, None] + sub).ravel()
    inside = np.hypot(*np.meshgrid(fine, fine)) <= radius
    kernel = inside.reshape(len(grid), 8, len(grid), 8).mean(axis=(1, 3))
    return cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT)


def _plain(truth):
    mean = cv2.blur(truth, (15, 15))
    return np.sqrt(np.clip(cv2.blur(truth**2, (15, 15)) - mean**2, 0.0, None)) < 0.5
