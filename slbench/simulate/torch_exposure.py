"""Frames exposed with gradients: panel response, light transport and detector in PyTorch.

The steps are those of :mod:`slbench.simulate.expose`, each with a gradient:

- *Rounding*, of panel values to the panel's levels and of grey values to whole numbers, passes the
  gradient on as if it were not there: straight through (Y. Bengio, N. Leonard, A. Courville,
  "Estimating or propagating gradients through stochastic neurons", arXiv:1308.3432, 2013).
- *Noise* is reparametrised: electrons are ``mean + sqrt(mean + read noise^2) z`` with a standard
  normal number z, the Gaussian approximation of the Poisson law, and the gradient goes through
  the mean and the deviation (D. P. Kingma, M. Welling, ICLR 2014).  Below some ten electrons the
  law is skewed, and the approximation poor.
- *Clipping* has no gradient beyond its limits.

The fixed pattern is the detector's own.  Vibration, frame errors
(:mod:`slbench.scene.frame_errors`) and colour pictures with cross-talk are not in it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slbench.core.errors import InputError, warn_user
from slbench.core.extras import extra
from slbench.detector import DetectorModel
from slbench.detector.emva1288 import Detector
from slbench.rig import Camera, Projector
from slbench.scene.model import Exposure
from slbench.simulate.expose import Shutter, shutter_for
from slbench.simulate.torch_light import Module, TorchLight
from slbench.simulate.transport import LightTransport, Marginal

#: Least variance whose root has a gradient, electrons^2.
_LEAST_VARIANCE = 1e-6


class TorchPanel(Module):  # type: ignore[misc]
    """A projector's response: from pattern values to light, as a share of full white.

    Parameters
    ----------
    projector : Projector
        Its bit depth, and its gamma or measured curve.
    gamma : tensor or Parameter, optional
        In the place of the projector's, to be learned for instance.
    """

    def __init__(self, projector: Projector, gamma: Any = None) -> None:
        torch = extra("torch", "torch")
        super().__init__()
        self.bit_depth = projector.bit_depth
        self.curved = projector.curve is not None and gamma is None
        self.linear = not self.curved and gamma is None and projector.gamma == 1.0
        if isinstance(gamma, torch.nn.Parameter):
            self.gamma = gamma
        else:
            exponent = projector.gamma if gamma is None else gamma
            exponent = torch.as_tensor(exponent, dtype=torch.float64)
            self.register_buffer("gamma", exponent, persistent=False)
        if self.curved:
            places, radiance = torch.tensor(projector.curve, dtype=torch.float64).T.contiguous()
            share = (radiance - radiance[0]) / (radiance[-1] - radiance[0])
            self.register_buffer("places", places, persistent=False)
            self.register_buffer("share", share, persistent=False)

    def forward(self, values: Any, *, rounded: bool = True) -> Any:
        """Return the light of pattern values; values outside [0, 1] are clipped."""
        torch = extra("torch", "torch")
        value = values.clamp(0.0, 1.0)
        if rounded and self.bit_depth is not None:
            top = 2.0**self.bit_depth - 1.0
            value = _straight_through(value, torch.round(value * top) / top)
        if self.linear:
            return value
        if self.curved:
            places, share = self.places.to(value.dtype), self.share.to(value.dtype)
            piece = torch.searchsorted(places, value.detach().contiguous(), right=True) - 1
            piece = piece.clamp(0, len(places) - 2)
            slope = (share[1:] - share[:-1]) / (places[1:] - places[:-1])
            return share[piece] + slope[piece] * (value - places[piece])
        lit = value > 0.0
        # Of an exponent below one the slope at black is infinite: none is passed on there.
        return torch.where(lit, value, 1.0) ** self.gamma.to(value.dtype) * lit


class TorchExposure(Module):  # type: ignore[misc]
    """Patterns in, frames out: panel, light transport and detector.

    Parameters
    ----------
    light : TorchLight
    panel : TorchPanel
    detector : DetectorModel
        Of the kind ``emva1288``.
    shutter : Shutter
        Of the scene (:func:`slbench.simulate.expose.shutter_for`).
    pixels : (P,) int, optional
        Those that `light` has, where it has not all.
    image : (int, int), optional
        Shape (V, U) of the camera's image; that of `light` by default.

    Raises
    ------
    InputError
        For another kind of detector, or PyTorch missing.
    """

    def __init__(
        self,
        light: TorchLight,
        panel: TorchPanel,
        detector: DetectorModel,
        shutter: Shutter,
        pixels: ArrayLike | None = None,
        image: tuple[int, int] | None = None,
    ) -> None:
        torch = extra("torch", "torch")
        super().__init__()
        if not isinstance(detector, Detector):
            raise InputError("exposure: detector", "one of kind emva1288", type(detector).__name__)
        self.light, self.panel, self.detector, self.shutter = light, panel, detector, shutter
        patterns = detector.fixed_pattern(image or (light.shape[0], light.shape[1]))
        for name, one in zip(("response", "offset"), patterns, strict=True):
            chosen = one if pixels is None else one.reshape(-1)[np.asarray(pixels)]
            tensor = torch.tensor(chosen, dtype=light.ambient.dtype, device=light.ambient.device)
            self.register_buffer(name, tensor, persistent=False)

    def electrons(self, values: Any, exposure: Any = 1.0, *, rounded: bool = True) -> Any:
        """Return mean electrons, without fixed pattern or clipping; arguments as for frames."""
        photo, dark = self._mean(values, exposure, rounded)
        return photo + dark

    def forward(
        self,
        values: Any,
        exposure: Any = 1.0,
        *,
        noise: bool = True,
        rounded: bool = True,
        generator: Any = None,
    ) -> Any:
        """Return frames.

        Parameters
        ----------
        values : (K, W), (K, H) or (K, H, W) tensor
            Pattern values in [0, 1].
        exposure : float or tensor, () or (K,)
            Of each frame, in units of the scene's own exposure time.
        noise : bool
            False: the expected frames, without fixed pattern, as
            :func:`slbench.simulate.expose.capture` has them.
        rounded : bool
            False: neither panel values nor grey values are rounded.
        generator : torch.Generator, optional
            Of the noise.

        Returns
        -------
        (K, V, U) tensor, or (K, P) for P chosen pixels
            DN.
        """
        torch = extra("torch", "torch")
        own = self.detector
        photo, dark = self._mean(values, exposure, rounded)
        if noise:
            mean = photo * self.response + dark
            variance = (mean + own.read_noise_e**2).clamp(min=_LEAST_VARIANCE)
            options = {"dtype": mean.dtype, "device": mean.device, "generator": generator}
            normal = torch.randn(mean.shape, **options)
            charge = mean + variance.sqrt() * normal + self.offset
            charge = charge.clamp(max=own.full_well_e)
        else:
            charge = (photo + dark).clamp(max=own.saturation_e)
        value = own.black_dn + charge / own.e_per_dn
        if rounded:
            value = _straight_through(value, torch.round(value))
        return value.clamp(0.0, float(own.top_dn))

    def variance(self, values: Any, exposure: Any = 1.0, *, rounded: bool = True) -> Any:
        """Return the variance of the frames, DN^2, that of rounding included."""
        own = self.detector
        mean = self.electrons(values, exposure, rounded=rounded)
        return (mean + own.read_noise_e**2) / own.e_per_dn**2 + 1.0 / 12.0

    def _mean(self, values: Any, exposure: Any, rounded: bool) -> tuple[Any, Any]:
        """Return mean electrons by light, and those in the dark."""
        radiance = self.light(self.panel(values, rounded=rounded))
        times = _of_frames(exposure, radiance)
        scale = self.detector.quantum_efficiency * self.shutter.photons
        dark = self.detector.dark_current_e_per_s * self.shutter.time_s
        return radiance * (scale * times), dark * times


def _of_frames(exposure: Any, frames: Any) -> Any:
    """Return exposures in a shape that multiplies frames (K, ...)."""
    torch = extra("torch", "torch")
    given = torch.as_tensor(exposure, dtype=frames.dtype, device=frames.device)
    return given.reshape(-1, *(1,) * (frames.ndim - 1)) if given.ndim else given


def _straight_through(value: Any, rounded: Any) -> Any:
    """Return rounded values with the gradient of what was rounded."""
    return value + (rounded - value).detach()


def torch_exposure(
    transport: LightTransport,
    camera: Camera,
    projector: Projector,
    detector: DetectorModel,
    exposure: Exposure,
    *,
    along: Marginal = "u",
    pixels: ArrayLike | None = None,
    gamma: Any = None,
    dense: bool = False,
    dtype: Any = None,
    device: Any = None,
    shutter: Shutter | None = None,
) -> TorchExposure:
    """Return the exposure of a scene's stored light as a module.

    Parameters
    ----------
    transport : LightTransport
    camera, projector, detector, exposure
        Of the scene; vibration and frame errors are left out.
    along, pixels, dense, dtype, device
        As :meth:`slbench.simulate.transport.LightTransport.torch` takes them.
    gamma : tensor or Parameter, optional
        In the place of the projector's response.
    shutter : Shutter, optional
        Where it is known.

    Raises
    ------
    InputError
        If PyTorch is not installed, the light has no such marginal, the detector is of another
        kind, or there are several exposures.

    Warns
    -----
    InputWarning
        If the exposure has frame errors.
    """
    if len(exposure.bracket) > 1:
        raise InputError("exposure", "one, for gradients", f"{len(exposure.bracket)} (bracket)")
    if exposure.has_frame_errors:
        left_out = "bit planes, lost triggers and drift are left out of an exposure with gradients"
        warn_user("exposure", left_out, stacklevel=3)
    light = transport.torch(along, pixels=pixels, dense=dense, dtype=dtype, device=device)
    shutter = shutter or shutter_for(transport, camera, detector, exposure)
    shutter = shutter.times(*exposure.bracket)
    panel = TorchPanel(projector, gamma).to(light.ambient.device)
    return TorchExposure(light, panel, detector, shutter, pixels, transport.shape)
