"""A measurement that is drawn again and again: one trace, few pixels.

Light is traced once.  A draw exposes the pixels on the features that are measured, decodes them,
triangulates them with the rig that it has drawn, and fits the features: what a scan does, without
the pixels that nobody asks for.  Without a draw of noise, frames are the expected ones and not
rounded, so that an input alone does what it does and rounding is part of the noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.bench.budget.inputs import BASELINE, CERTIFICATE, EXPANSION, GAMMA, TEMPERATURE, Input
from slbench.bench.budget.measurand import Measurand, measurand_of
from slbench.capture.exposures import Bracket
from slbench.cloud.triangulation import meet
from slbench.core.errors import InputError, located
from slbench.core.random import generator
from slbench.core.units import REFERENCE_C
from slbench.detector.emva1288 import Detector
from slbench.patterns import decode
from slbench.rig import Pose, Rig
from slbench.rig.parameters import RIG_PARAMETERS, moved
from slbench.scene.model import Scene
from slbench.score.features import fit_features
from slbench.simulate.expose import (
    bracket_seed,
    lighting,
    move_pictures,
    radiance_batches,
    shutter_for,
)
from slbench.simulate.frame_errors import frame_errors
from slbench.simulate.lights import Lights
from slbench.simulate.reconstruct import joining_motion
from slbench.simulate.stack import check_frame_errors
from slbench.simulate.transport import LightTransport

Array = NDArray[np.float64]

NOISE, PATTERN, VIBRATION, CALIBRATION = "noise", "fixed pattern", "vibration", "calibration"
#: Pixels around a feature's that may come to lie on it in a draw, and around those for vibration.
_MARGIN_PX, _SHAKEN_PX = 3, 8


class Measurement:
    """What is measured of features of a scene, as a model of inputs.

    Parameters
    ----------
    scene : Scene
    measurands : sequence of str
        Quantities of features, as claims have them: ``step[5].measured_mm``.
    inputs : sequence of Input
        Whose estimates are those of the measurement.
    lights : Lights
        Light and truth, traced where they are not at hand.
    on_progress : callable, optional
        Called with the finished fraction of the trace.

    Raises
    ------
    InputError
        For a scene with focus settings or motion, a calibration model, a mosaic or frames packed in
        pictures in colour, a quantity that is not one of a feature of the scene, and an offset,
        which is in mm, of what is not.
    """

    def __init__(
        self,
        scene: Scene,
        measurands: Sequence[str],
        inputs: Sequence[Input],
        lights: Lights,
        on_progress: Any = None,
    ) -> None:
        where = f"scene {scene.name}"
        if scene.focus is not None:
            raise InputError(f"{where}: focus", "none: draws are of single pictures", "settings")
        if scene.moves:
            raise InputError(where, "nothing that moves: draws are of one light", "motion")
        if scene.calibration is not None and scene.calibration.model is not None:
            raise InputError(f"{where}: calibration", "a rig to measure with", "a model")
        if scene.colour is not None:
            if scene.colour.bayer is not None:
                expected = "no mosaic: draws are of single pixels"
                raise InputError(f"{where}: colour", expected, f"bayer = {scene.colour.bayer}")
            if scene.sequence.channels > 1:
                expected = "grey patterns in colour: draws are of one sensor"
                raise InputError(f"{where}: patterns", expected, "several frames a picture (+rgb)")
        scene.sequence.runs()
        with located(where):
            check_frame_errors(scene)
        self._scene = scene
        self.measurands = [measurand_of(one, scene) for one in measurands]
        self._estimates = {one.name: one.value for one in inputs if one.scalar}
        self._acts = {one.name: one.acts for one in inputs if one.acts is not None}
        for name in (name for name, acts in self._acts.items() if acts == "offset"):
            for one in self.measurands:
                if one.unit != "mm":
                    got = f"{one.text} in {one.unit or '1'}: acts = scale?"
                    raise InputError(f"input {name}", "measurands in mm of an offset in mm", got)
        self._transport = lights.traced(scene, on_progress=on_progress)[0]
        self._truth = truth = lights.truth(scene)
        with lighting(scene):
            self._shutter = shutter_for(
                self._transport, scene.rig.camera, scene.detector, scene.exposure
            )
        self._shutters = [self._shutter.times(factor) for factor in scene.exposure.bracket]
        # Only a feature's own uncertainty asks how errors go together.
        self._lines = any("uncertainty" in one.field for one in self.measurands)
        owners = {one.item for one in self.measurands}
        usable = self._usable(owners)
        self._flat = np.flatnonzero(usable)
        rows, columns = np.nonzero(usable)
        self._pixels = np.column_stack((columns, rows))
        self._owner = truth.object_id.ravel()[self._flat]
        self._smooth = truth.smooth().ravel()[self._flat]
        self._true = truth.point.reshape(-1, 3)[self._flat]
        self._few = self._transport.chosen(self._flat)
        own = scene.calibration
        self._rig = scene.rig if own is None or own.rig is None else own.rig
        self._align = own is not None and own.align
        #: Phase and light without any draw that changes them.
        self._still: dict[Any, Any] = {}

    def _usable(self, owners: set[int]) -> NDArray[np.bool_]:
        """Return a mask of lit pixels on and around the features that are measured."""
        truth, scene = self._truth, self._scene
        near = np.zeros(truth.lit.shape, bool)
        for k in owners:
            item = scene.objects[k]
            own = truth.object_id == k
            local = item.pose.to_local(truth.point[own])
            asked = [one for one in self.measurands if one.item == k]
            near[own] |= _region(asked, item.artefact, local)
        side = 2 * _MARGIN_PX + 1
        near = cv2.dilate(near.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
        usable: NDArray[np.bool_] = near & truth.lit & np.isin(truth.object_id, list(owners))
        return usable

    def __len__(self) -> int:
        """How many pixels a draw measures."""
        return len(self._flat)

    def __call__(self, drawn: Mapping[str, Any]) -> Array:
        """Return the measurands (m,) of a draw; NaN for one that was not measured."""
        values = {**self._estimates, **drawn}
        panel, sigma, mask = self._decoded(values)
        rig = self._measuring(values)
        axes = self._scene.sequence.axes
        points, sensitivity = meet(rig, self._pixels[mask], axes, panel[mask], sigma[mask])
        good = np.isfinite(points.sum(axis=1)) & np.isfinite(sensitivity.sum(axis=(1, 2)))
        chosen = np.flatnonzero(mask)[good]
        points = points[good]
        if self._align:
            points = joining_motion(self._scene, rig, axes).to_world(points)
        return self._of_points(points, chosen, values)

    def true(self) -> Array:
        """Return the measurands (m,) of the true points of the same pixels."""
        return self._of_points(self._true, np.arange(len(self._flat)), self._estimates)

    def half(self) -> Array | None:
        """Return the measurands (m,) by half of the light's samples; None where none were kept."""
        half = self._few.half()
        if half is None:
            return None
        whole, still = self._few, self._still
        self._few, self._still = half, {}
        found = self({})
        self._few, self._still = whole, still
        return found

    def _of_points(
        self, points: Array, chosen: NDArray[np.intp], values: Mapping[str, Any]
    ) -> Array:
        found: dict[int, Sequence[Any]] = {}
        for k in {one.item for one in self.measurands}:
            item, own = self._scene.objects[k], self._owner[chosen] == k
            lines = None
            if self._lines:
                lines = self._pixels[chosen[own], 0 if "u" in self._scene.sequence.axes else 1]
            part = item.artefact, item.pose, lines, self._scene.rig, self._smooth[chosen[own]]
            found[k] = fit_features(points[own], *part)
        return np.array([self._corrected(one, found[one.item], values) for one in self.measurands])

    def _corrected(self, one: Measurand, scores: Sequence[Any], values: Mapping[str, Any]) -> float:
        """Return a measurand with what temperature, certificate and corrections make of it."""
        value, size = one.signed(scores)
        value += size  # what was measured: of a deviation, what the nominal size is taken from
        if one.unit == "mm":
            # The part has its size of the estimated temperature and is brought to the reference by
            # the one that is drawn.
            value /= self._growth(values) / self._growth(self._estimates)
            size += values.get(CERTIFICATE, 0.0) if one.of_nominal else 0.0
        for name, acts in self._acts.items():
            value = value + values[name] if acts == "offset" else value * (1.0 + values[name])
        return abs(value - size) if one.magnitude else value - size

    def _growth(self, values: Mapping[str, Any]) -> float:
        """Return length over that at the reference temperature."""
        above = values.get(TEMPERATURE, REFERENCE_C) - REFERENCE_C
        return float(1.0 + values.get(EXPANSION, 0.0) * above)

    def _measuring(self, values: Mapping[str, Any]) -> Rig:
        """Return the rig that is measured with."""
        error = dict(values.get(CALIBRATION, {}))
        for name in RIG_PARAMETERS:
            if name in values:
                error[name] = error.get(name, 0.0) + values[name]
        with located("budget: a draw of the rig"):
            rig = moved(self._rig, error)
        longer = values.get(BASELINE, 0.0)
        if longer:
            camera, projector = rig.camera.pose.position, rig.projector.pose
            place = camera + (1.0 + longer) * (projector.position - camera)
            other = replace(rig.projector, pose=Pose(projector.rotation, place))
            rig = rig.having(**{rig.only.projector: other})
        return rig

    def _decoded(self, values: Mapping[str, Any]) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return panel coordinates and deviations (P, A), px, and what was measured (P,)."""
        streams = [values.get(name) for name in (NOISE, PATTERN, VIBRATION)]
        key = None
        if all(one is None for one in streams):
            key = "phase", values.get(GAMMA)
            if key in self._still:
                return self._still[key]  # type: ignore[no-any-return]
        detector, sequence = self._scene.detector, self._scene.sequence
        frames = self._frames(values)
        phase = decode(
            frames,
            sequence,
            noise=detector.noise_model(),
            saturation=float(detector.saturation_dn),
        )
        panel = np.stack([phase.coordinate[axis].ravel() for axis in sequence.axes], axis=-1)
        sigma = np.stack([phase.sigma[axis].ravel() for axis in sequence.axes], axis=-1)
        found = panel, sigma, phase.mask.ravel()
        if key is not None:
            self._keep(key, found)
        return found

    def _keep(self, key: Any, found: Any) -> None:
        """Keep what the estimates give; draws of gamma come once."""
        if key[1] == self._estimates.get(GAMMA):
            self._still[key] = found

    def _frames(self, values: Mapping[str, Any]) -> NDArray[Any]:
        """Return frames (N, 1, P) in DN: rounded with noise, expected ones without."""
        radiance = self._radiance(values)
        found = [self._exposed(radiance, values, k) for k in range(len(self._shutters))]
        if len(found) == 1:
            return found[0]
        times = [shutter.time_s for shutter in self._shutters]
        return Bracket.of(np.stack(found), times, self._scene.detector.saturation_dn).frames

    def _exposed(
        self, radiance: NDArray[np.float32], values: Mapping[str, Any], k: int
    ) -> NDArray[Any]:
        """Return frames (N, 1, P) at one of the exposures."""
        detector, (factor, time_s) = self._scene.detector, self._shutters[k]
        pattern = values.get(PATTERN)
        if values.get(NOISE) is not None:
            if isinstance(detector, Detector):
                uneven = {"seed": pattern % (1 << 32)} if pattern is not None else _EVEN
                detector = replace(detector, **uneven)
            rng = generator(bracket_seed(values[NOISE], k))
            return detector.expose(radiance, time_s, rng, True, factor)
        photons = radiance.astype(np.float64) * factor
        if pattern is None:
            return np.asarray(detector.expected_dn(photons, time_s))
        assert isinstance(detector, Detector)  # no other has a pattern
        rng, count = generator(pattern), len(self._flat)
        gain = np.maximum(1.0 + detector.prnu * rng.standard_normal(count), 0.0)
        offset = detector.dsnu_e / detector.e_per_dn * rng.standard_normal(count)
        return np.asarray(detector.expected_dn(photons * gain, time_s)) + offset

    def _radiance(self, values: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return radiance under the patterns, (N, 1, P)."""
        shaken, gamma = values.get(VIBRATION), values.get(GAMMA)
        key = "images" if shaken is not None else "radiance", gamma
        light = self._still.get(key)
        if light is None:
            whole = self._transport if shaken is not None else self._few
            light = self._relit(whole, gamma)
            if shaken is not None:
                light = light[:, *self._window()]
            self._keep(key, light)
        if shaken is None:
            return light  # type: ignore[no-any-return]
        channels = self._scene.sequence.channels
        pictures = -(-len(light) // channels)
        moves = generator(shaken).normal(0.0, self._scene.exposure.vibration_px, (pictures, 2))
        moving = light.copy()
        move_pictures(moving, moves[np.arange(len(light)) // channels])
        rows, columns = self._window()
        v, u = self._pixels[:, 1] - rows.start, self._pixels[:, 0] - columns.start
        return np.ascontiguousarray(moving[:, v, u][:, None])

    def _window(self) -> tuple[slice, slice]:
        """Return the rows and columns of the image that pixels lie in, with a margin."""
        height, width = self._truth.lit.shape
        (low_u, low_v), (high_u, high_v) = self._pixels.min(axis=0), self._pixels.max(axis=0)
        reach = _SHAKEN_PX + int(6.0 * self._scene.exposure.vibration_px)
        rows = slice(max(low_v - reach, 0), min(high_v + reach + 1, height))
        return rows, slice(max(low_u - reach, 0), min(high_u + reach + 1, width))

    def _relit(self, light: LightTransport, gamma: float | None) -> NDArray[np.float32]:
        projector, sequence = self._scene.rig.projector, self._scene.sequence
        if gamma is not None:
            with located(f"budget: a draw of {GAMMA}"):
                projector = replace(projector, gamma=float(gamma))
        out = np.empty((sequence.n_frames, *light.shape), np.float32)
        # Of frame errors what is the same in every scan.
        pictures = -(-sequence.n_frames // sequence.channels)
        given = self._scene.exposure, projector, pictures, self._shutter.time_s
        errors = frame_errors(*given, seed=0, noise=False)
        for indices, radiance in radiance_batches(light, sequence, projector, errors):
            out[indices] = radiance
        return out


#: A detector without a fixed pattern.
_EVEN: dict[str, Any] = {"prnu": 0.0, "dsnu_e": 0.0}


def _region(measurands: Sequence[Measurand], artefact: Any, local: Array) -> NDArray[np.bool_]:
    """Return a mask of points (n, 3) on features; of all where their place is not known."""
    found = np.zeros(len(local), bool)
    declared = {surface.name for surface in artefact.declared}
    for one in (each.feature for each in measurands):
        if one.name in declared:
            found[:] = True
        elif one.kind in ("plane", "step"):
            wanted = {one.name, "reference"} if one.kind == "step" else {one.name}
            for face in artefact.planes:
                if face.name in wanted:
                    found |= face.contains(local)
        elif one.kind in ("sphere", "spacing"):
            wanted = {one.name} if one.kind == "sphere" else set(one.name.split(" to "))
            for ball in artefact.spheres:
                if ball.name in wanted:
                    off = np.linalg.norm(local - np.array(ball.centre_mm), axis=1)
                    found |= np.abs(off - ball.radius_mm) < 0.2 * ball.radius_mm
        else:
            found[:] = True
    return found
