"""Focus stacks with a known all-in-focus image and depth: sums of sinusoids, blurred exactly.

A Gaussian of standard deviation s multiplies a sinusoid of frequency f by exp(-2 pi^2 f^2 s^2),
so the image of a plane slanted along u, every pixel gathered with the blur of its own depth,
is known in closed form at every pixel.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SlantedPlane:
    """A textured plane at depth `depth` (U,), seen at the focus positions (P,)."""

    texture: np.ndarray  # (K, 4): cycles a pixel along v and u, phase, amplitude
    depth: np.ndarray
    positions: np.ndarray
    shape: tuple[int, int]
    blur_px: float  # standard deviation of the blur, pixels a unit of defocus

    def image(self, blur, texture=None, mean=0.5):
        """The plane at the blur (U,) of each column, (V, U)."""
        fv, fu, phase, amplitude = (self.texture if texture is None else texture).T[:, :, None]
        v, u = (np.arange(n)[None] for n in self.shape)
        down = np.exp(2j * np.pi * fv * v + 1j * phase) * amplitude
        contrast = np.exp(-2 * np.pi**2 * (fv**2 + fu**2) * np.asarray(blur) ** 2)
        across = np.exp(2j * np.pi * fu * u) * contrast
        return mean + (down.T @ across).real

    def blur(self, p):
        return self.blur_px * np.abs(self.positions[p] - self.depth)

    def sharp(self, **kwargs):
        return self.image(np.zeros(self.shape[1]), **kwargs)

    def stack(self, **kwargs):
        return np.array([self.image(self.blur(p), **kwargs) for p in range(len(self.positions))])

    def nearest(self):
        """The frame of least blur at each column, (U,)."""
        return np.abs(self.positions[:, None] - self.depth).argmin(axis=0)

    def select(self, stack, choice):
        return np.take_along_axis(stack, choice[None, None, :], axis=0)[0]


def slanted_plane(frames=15, shape=(160, 192), margin=2.0, blur_px=0.8, contrast=0.12, seed=0):
    """A plane with random texture of all frequencies from 0.02 to 0.4 cycles a pixel.

    `contrast` is the standard deviation of the texture around a mean of 0.5; the depth keeps
    `margin` frames away from both ends of the stack.
    """
    rng = np.random.default_rng(seed)
    count = 300
    frequency = rng.uniform(0.02, 0.4, count)
    direction = rng.uniform(0, 2 * np.pi, count)
    texture = np.stack(
        [
            frequency * np.sin(direction),
            frequency * np.cos(direction),
            rng.uniform(0, 2 * np.pi, count),
            np.full(count, contrast * np.sqrt(2 / count)),
        ],
        axis=1,
    )
    depth = np.linspace(margin, frames - 1 - margin, shape[1])
    return SlantedPlane(texture, depth, np.arange(float(frames)), shape, blur_px)


def psnr_db(image, truth, border=8):
    """Peak signal-to-noise ratio for grey in [0, 1], away from the border.

    Windows of the focus measure reach past the border, where pixels are repeated.
    """
    inner = np.s_[border:-border, border:-border]
    return -10 * np.log10(np.mean((image[inner] - truth[inner]) ** 2))
