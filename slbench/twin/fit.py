"""What is fitted to the frames of a capture when its scene is traced."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.core.errors import InputError, warn_user
from slbench.detector.emva1288 import Detector
from slbench.rig.optics.shading import shading
from slbench.scene.devices.detector import SheetKeys
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.expose import radiance_batches, shutter_for
from slbench.simulate.stack import traced
from slbench.simulate.transport import LightTransport
from slbench.twin.content import AMBIENT_W_PER_M2
from slbench.twin.light import Light, fit_blur, fit_light
from slbench.twin.likeness import LEAST, averaged, contrast_likeness

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Frames = NDArray[np.float32]

#: Border of what is compared, px.
_BORDER = 4


class Fit:
    """Light and frames of a scene beside photographs, and what is fitted to them."""

    def __init__(self, scene: Scene, capture: Capture, out: Mask, mask: Mask, seed: int) -> None:
        if not isinstance(scene.detector, Detector):
            raise InputError(
                "twin: detector", "an EMVA 1288 detector", type(scene.detector).__name__
            )
        self.scene = replace(scene, sequence=capture.sequence)
        self.capture, self.out, self.mask, self.seed = capture, out, mask, seed
        self.detector: Detector = _black(scene.detector, capture)
        self.scene = replace(self.scene, detector=self.detector)
        self.transport = traced(self.scene, seed=seed)[0]
        self.truth = _truth(self.scene)
        lit = np.all(capture.frames < capture.top_dn, axis=0)
        self.where = _inner(self.truth.smooth() & mask & lit)
        if np.count_nonzero(self.where) < LEAST:
            raise InputError(
                "twin",
                f"at least {LEAST} pixels of smooth, lit, unsaturated surface on the object",
                int(np.count_nonzero(self.where)),
            )
        self.radiance = radiance_of(self.transport, self.scene)
        self.light = self._light()

    def _light(self) -> Light:
        where, fitted = self.where, ~self.out
        v, u = np.nonzero(where)
        camera = self.scene.rig.camera
        ambient = self.transport.ambient[where].astype(np.float64)
        frames = self.capture.frames[fitted][:, where].astype(np.float64)
        return fit_light(
            frames - self.detector.black_dn,
            np.asarray(self.detector.noise_model().variance(frames)),
            self.radiance[fitted][:, where] - ambient,
            ambient,
            np.stack((u, v), axis=1),
            (camera.width, camera.height),
            self.detector.black_dn,
        )

    def lacking_blur(self) -> float:
        """Return the blur of the projector that the fitted fringes lack, px along u."""
        camera = self.scene.rig.camera
        own = shading(self.light.shading, camera.pixel_grid(), (camera.width, camera.height))
        ambient = (self.light.ambient - 1.0) * self.transport.ambient
        frames = (self.light.gain * own * (self.radiance + ambient)).astype(np.float32)
        found = contrast_likeness(self.capture, frames, self.where, self.out)
        told = [one for one in found if not one.held_out] or found
        pitch = self.scene.rig.projector.pitch_mm
        along = {"u": 1.0, "v": pitch[0] / pitch[1]}
        return fit_blur(
            [along[one.axis] * one.cycles_per_px for one in told], [one.ratio for one in told]
        )

    def blurred(self, blur_px: float) -> Fit:
        """Return the same with a projector that blurs."""
        rig = self.scene.rig
        scene = replace(
            self.scene, rig=rig.having(projector=replace(rig.projector, blur_px=blur_px))
        )
        return Fit(scene, self.capture, self.out, self.mask, self.seed)

    @property
    def photons(self) -> float:
        """Photons a unit of radiance that the fitted gain means."""
        return self.light.gain * self.detector.e_per_dn / self.detector.quantum_efficiency

    def exposed(self, scene: Scene) -> Fit:
        """Return the fit traced as the finished scene, its exposure by the same frames."""
        return Fit(scene, self.capture, self.out, self.mask, self.seed)


def with_light(content: Mapping[str, Any], fit: Fit, blur: float | None) -> dict[str, Any]:
    """Return a scene's content with the light that was fitted."""
    done = {
        key: dict(value) if isinstance(value, dict) else value for key, value in content.items()
    }
    light = fit.light
    done["light"]["ambient_w_per_m2"] = light.ambient * AMBIENT_W_PER_M2
    done["camera"]["shading"] = list(light.shading)
    detector = _lifted(fit.detector, light.black_dn)
    for key in SheetKeys.model_fields:  # which stand for some of these
        done["detector"].pop(key, None)
    for key in ("offset_dn", "read_noise_e", "gain_e_per_dn", "full_well_e"):
        done["detector"][key] = getattr(detector, key)
    if blur is not None:
        done["projector"]["blur_px"] = blur
    # Where the automatic exposure puts the lit picture at this gain.
    camera = fit.scene.rig.camera
    own = shading(light.shading, camera.pixel_grid(), (camera.width, camera.height))
    marginals = {name: rows.scaled(own.ravel()) for name, rows in fit.transport.marginals.items()}
    ambient = (light.ambient * own * fit.transport.ambient).astype(np.float32)
    shaded = replace(fit.transport, marginals=marginals, ambient=ambient)
    usual = replace(fit.scene.exposure, time_s=None, white_level=0.5)
    factor = shutter_for(shaded, camera, detector, usual).photons
    level = 0.5 * fit.photons / factor
    if level > 1.0:
        warn_user(
            "twin",
            f"the white panel would be {level:.3g} times saturation: frames that saturate, or a "
            "gain or full well of another camera",
        )
    done["exposure"]["white_level"] = min(level, 1.0)
    return done


def _black(detector: Detector, capture: Capture) -> Detector:
    """Return a detector whose black level is not above the capture's own black frames.

    That of another capture may have stray light in it, whose noise is part of its read noise.
    """
    dark = [
        capture.frames[k]
        for k, frame in enumerate(capture.sequence.frames())
        if frame.part.flat_level(frame.index) == 0.0
    ]
    if not dark:
        return detector
    mean = np.mean(dark, axis=0)
    seen = np.isfinite(mean)
    if not seen.any():
        return detector
    least = float(np.quantile(averaged(mean, seen)[seen], 0.01))
    return _lifted(detector, min(least - detector.black_dn, 0.0))


def _lifted(detector: Detector, by_dn: float) -> Detector:
    """Return a detector of another black level and the same noise of every digital number.

    Where its numbers end before its pixels are full, they still do.
    """
    black, gain = max(detector.black_dn + by_dn, 0.0), detector.e_per_dn
    more_e = (black - detector.black_dn) * gain
    well_e = detector.full_well_e
    if detector.saturation_dn >= detector.top_dn - 1:
        well_e = max(well_e, (detector.top_dn - black) * gain)
    return replace(
        detector,
        offset_dn=black,
        read_noise_e=float(np.sqrt(max(detector.read_noise_e**2 + more_e, 0.0))),
        gain_e_per_dn=gain,
        full_well_e=well_e,
    )


def _inner(mask: Mask) -> Mask:
    """Return a mask without its border, where edges and blur are seen."""
    from scipy.ndimage import binary_closing, binary_erosion

    # Single pixels that noise left out have no border.
    whole = binary_closing(mask, iterations=1) | mask
    return mask & np.asarray(binary_erosion(whole, iterations=_BORDER))


def _truth(scene: Scene) -> GroundTruth:
    from slbench.simulate.render.groundtruth import ground_truth

    return ground_truth(scene.objects, scene.rig)


def radiance_of(transport: LightTransport, scene: Scene) -> Frames:
    """Return the radiance of all frames of a scene, (N, V, U)."""
    frames = np.empty((scene.sequence.n_frames, *transport.shape), np.float32)
    for indices, radiance in radiance_batches(transport, scene.sequence, scene.rig.projector):
        frames[indices] = radiance
    return frames
