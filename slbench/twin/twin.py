"""The twin: a scene that stands for a real scanner and what it photographed, and how well it does.

The object is placed by the measured cloud.  Brightness, ambient light and the projector's blur
beside what the rig's apertures make are fitted to some of the frames; the others, which nothing was
fitted to, are simulated and compared.  The scene is an ordinary one: everything that runs on a
scene runs on it.
"""

from __future__ import annotations

import shutil
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.capture.noise import noise_of
from slbench.cloud.decoded import decode_capture
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError, InputWarning, located, warn_user
from slbench.core.io import OutputFolder, write_json, write_toml
from slbench.core.show.display import block, brief
from slbench.core.show.drawing import figure
from slbench.detector.emva1288 import Detector
from slbench.objects import Artefact, build_artefact, load_artefact
from slbench.objects.mesh.file import SUFFIXES
from slbench.patterns import Fringes
from slbench.rig import Pose
from slbench.rig.opencv import write_rig
from slbench.rig.shading import shading
from slbench.scene.devices.detector import SheetKeys
from slbench.scene.devices.optics import CameraOptics, ProjectorOptics
from slbench.scene.file import load_scene, read_merged
from slbench.scene.model import Scene
from slbench.scene.tables import CameraBeside, ProjectorBeside
from slbench.scene.truth import GroundTruth
from slbench.simulate.expose import capture as exposed
from slbench.simulate.expose import radiance_batches, shutter_for
from slbench.simulate.stack import traced
from slbench.simulate.transport import LightTransport
from slbench.twin.light import Light, fit_blur, fit_light
from slbench.twin.likeness import (
    LEAST,
    Likeness,
    PointLikeness,
    averaged,
    contrast_likeness,
    frame_likeness,
    noise_likeness,
)
from slbench.twin.placing import Place, place

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Frames = NDArray[np.float32]

TWIN_FOLDER = OutputFolder(
    "twin",
    ("twin.toml", "twin.json", "twin.png", "rig.yaml", "*.csv", *(f"*{s}" for s in SUFFIXES)),
)
#: Samples a pixel, by default; irradiance of the surroundings that ambient light is fitted with.
SAMPLES, _AMBIENT_W_PER_M2 = 64, 1.0
#: Border of what is compared, px.
_BORDER = 4
#: Share of the points that may lie on no object.
_UNEXPLAINED = 0.2
#: Bits of the twin's frames where photographs are floats.
_FLOAT_BITS = 16


@dataclass(frozen=True, kw_only=True)
class TwinObject:
    """An object of the twin and about where it is.

    Parameters
    ----------
    shape : str
        ``"plane"``, as large as what is seen of it; the name of a shipped artefact; or a mesh
        file.
    unit : str or None
        Of a mesh file.
    material : str
        A preset's name.
    start : Pose or None
        Looked for by default.
    """

    shape: str
    unit: str | None = None
    material: str = "matt-white-spray"
    start: Pose | None = None

    __repr__ = brief

    def artefact(self) -> Artefact:
        """Return its artefact; a plane of any size.

        Raises
        ------
        InputError
            For no artefact, or a mesh file without a unit.
        """
        if self.shape == "plane":
            return build_artefact("plane", {"size_mm": [1e3, 1e3]}, "plane")
        if Path(self.shape).suffix.lower() in SUFFIXES:
            if self.unit is None:
                raise InputError(self.shape, "the unit of the mesh file, such as mm", "none")
            given = {"path": self.shape, "unit": self.unit}
            return build_artefact("mesh", given, self.shape, name=Path(self.shape).stem)
        return load_artefact(self.shape)


@dataclass(frozen=True, eq=False, kw_only=True)
class Twin:
    """A scene that stands for a real scanner, and how far it is from its photographs.

    Parameters
    ----------
    content : dict
        Of the scene's file.
    scene : Scene
    files : mapping of str to Path
        Mesh files beside the scene, by their names there.
    places : tuple of Place
        Of the objects.
    light : Light
        What was fitted.
    blur_px : float or None
        Of the projector, where it was fitted.
    likeness : Likeness
    capture, simulated : Capture
        Photographs and frames of the twin with noise.
    expected : (N, V, U) float32
        Frames of the twin before noise and rounding, DN.
    """

    content: dict[str, Any]
    scene: Scene
    files: Mapping[str, Path]
    places: tuple[Place, ...]
    light: Light
    blur_px: float | None
    likeness: Likeness
    capture: Capture = field(repr=False)
    simulated: Capture = field(repr=False)
    expected: Frames = field(repr=False)

    def __repr__(self) -> str:
        misfits = self.likeness.misfits()
        return block(f"Twin {self.scene.name}: {'does not fit' if misfits else 'fits'}", *misfits)

    def plot(self) -> Any:
        """Return a matplotlib figure: frames, contrast, points."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        placed = [
            {
                "position_mm": one.pose.position,
                "rotation": one.pose.rotation,
                "usual_residual_mm": one.scale_mm,
                "points_on_it": one.agreeing,
                "not_told_by_faces": list(one.free),
            }
            for one in self.places
        ]
        fitted = {"white_level": self.scene.exposure.white_level, "shading": self.light.shading}
        fitted["ambient_w_per_m2"] = self.light.ambient * _AMBIENT_W_PER_M2
        fitted["black_dn"] = self.scene.detector.black_dn
        if self.blur_px is not None:
            fitted["projector_blur_px"] = self.blur_px
        return {"fitted": fitted, "objects": placed} | self.likeness.to_dict()


def make_twin(
    capture: Capture,
    objects: Sequence[TwinObject],
    *,
    hardware: str | Path | None = None,
    held_out: Sequence[Capture] = (),
    bounces: int | None = None,
    samples: int = SAMPLES,
    name: str = "twin",
    seed: int = 0,
    on_progress: Callable[[str, float], None] | None = None,
) -> Twin:
    """Make the twin of a scanner by what it photographed of known objects.

    Parameters
    ----------
    capture : Capture
        With its rig.
    objects : sequence of TwinObject
        Placed one after the other, each by the points that are on none before it.
    hardware : path, optional
        Tables of a scene that ``slbench characterise`` wrote, or a hardware file; without it the
        noise is that of the capture.
    held_out : sequence of Capture
        Further captures of the same, unmoved: they are compared, and nothing is fitted to them.
        Without any, repeats and every second set of the capture are.
    bounces : int, optional
        Interreflections; by default none of a plane alone, else 2.
    samples : int
        Monte Carlo samples a pixel.
    name : str
        Of the scene.
    seed : int
    on_progress : callable, optional

    Returns
    -------
    Twin

    Raises
    ------
    InputError
        For a capture without a rig, or of colour pictures; objects that are not where the points
        are; hardware of another camera.

    Warns
    -----
    InputWarning
        If many points lie on no object, or the fitted exposure saturates.
    """
    report = on_progress or (lambda stage, fraction: None)
    if capture.rig is None:
        raise InputError("twin", "a capture with its rig (--rig)", "none")
    if capture.sequence.crosstalk is not None:
        raise InputError("twin", "grey frames", "colour pictures (crosstalk)")
    if not objects:
        raise InputError("twin: objects", "at least one", "none")
    artefacts = [one.artefact() for one in objects]
    report("decode", 0.0)
    decoded = decode_capture(capture)
    cloud = decoded.cloud
    assert cloud is not None  # there is a rig
    report("decode", 1.0)
    places = _placed(artefacts, objects, cloud, capture, report)
    every = _joined(capture, held_out)
    out = _held_out(capture, len(every.frames))
    given = hardware_tables(hardware, capture)
    content, files = _content(name, capture, objects, places, given, bounces, samples)
    with tempfile.TemporaryDirectory() as folder:
        write_scene(Path(folder), content, capture, files)
        with located(f"twin of {hardware}" if hardware else "twin"):
            base = load_scene(Path(folder) / "twin.toml")
        report("trace", 0.0)
        fit = _Fit(base, every, out, decoded.phase.mask, seed)
        blur = None
        if _has_fringes(capture):
            blur = fit.lacking_blur()
            if blur:
                report("trace", 0.5)
                fit = fit.blurred(blur)
        content = _with_light(content, fit, blur)
        write_scene(Path(folder), content, capture, files)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)  # said of the first
            scene = load_scene(Path(folder) / "twin.toml")
    report("trace", 0.9)
    done = fit.exposed(scene)
    return _compared(done, places, files, content, blur, cloud, fit.light, seed)


def _placed(
    artefacts: Sequence[Artefact],
    objects: Sequence[TwinObject],
    cloud: PointCloud,
    capture: Capture,
    report: Callable[[str, float], None],
) -> tuple[Place, ...]:
    """Place objects one after the other, each by the points that are on none before it."""
    assert capture.rig is not None
    found: list[Place] = []
    left = np.ones(len(cloud), bool)
    for k, (artefact, one) in enumerate(zip(artefacts, objects, strict=True)):
        report("place", k / len(artefacts))
        with located(f"twin: {one.shape}"):
            found.append(place(artefact, cloud.chosen(left), capture.rig, one.start))
        columns, rows = cloud.pixels.T
        with np.errstate(invalid="ignore"):
            left &= ~(np.abs(found[-1].residual_mm[rows, columns]) <= 5.0 * found[-1].scale_mm)
    report("place", 1.0)
    share = float(np.mean(left))
    if share > _UNEXPLAINED:
        warn_user(
            "twin",
            f"{100 * share:.3g} % of the points lie on no object: something else in view (another "
            "--object, plane for what it stands on), another shape, or a wrong rig?",
        )
    return tuple(found)


def _joined(capture: Capture, others: Sequence[Capture]) -> Capture:
    """Return one capture of the frames of all."""
    parts, frames = list(capture.sequence.parts), [capture.frames]
    for other in others:
        for what, a, b in (
            ("a panel of", capture.sequence.panel, other.sequence.panel),
            ("frames of", capture.frames.shape[1:][::-1], other.frames.shape[1:][::-1]),
            ("a bit depth of", capture.bit_depth, other.bit_depth),
        ):
            if a != b:
                raise InputError("twin: held-out capture", f"{what} {a}, as the other has", b)
        parts += other.sequence.parts
        frames.append(other.frames)
    sequence = replace(capture.sequence, parts=tuple(parts))
    return replace(capture, frames=np.concatenate(frames), sequence=sequence)


def _held_out(capture: Capture, count: int) -> Mask:
    """Return which of `count` frames nothing is fitted to, those after the capture's among them."""
    out = np.zeros(count, bool)
    own = len(capture.frames)
    out[own:] = True
    if count > own:
        return out
    seen = set()
    for k, frame in enumerate(capture.sequence.frames()):
        out[k] = (frame.part, frame.index) in seen
        seen.add((frame.part, frame.index))
    sets = {one.code: one for one in reversed(capture.sequence.placed()) if len(one.frames) > 1}
    panel = capture.sequence.panel
    # The finest tells the blur.
    fine = sorted(sets.values(), key=lambda one: -(one.code.fringe_count(panel) or 0.0))
    for one in fine[1::2]:
        out[one.frames.start : one.frames.stop] = True
    if not out.any():  # one set alone
        out[1::2] = True
    return out


def hardware_tables(path: str | Path | None, capture: Capture) -> dict[str, dict[str, Any]]:
    """Return the tables of a hardware file, with the capture's noise where it has none.

    Parameters
    ----------
    path : path or None
    capture : Capture

    Returns
    -------
    dict
        ``camera``, ``projector``, ``detector`` and ``exposure``.

    Raises
    ------
    InputError
        For another camera's resolution or bit depth.
    """
    read = {} if path is None else read_merged(Path(path))
    tables = {name: dict(read.get(name, {})) for name in ("camera", "projector", "detector")}
    tables["exposure"] = {
        key: value for key, value in read.get("exposure", {}).items() if key == "vibration_px"
    }
    sizes = {"camera": capture.frames.shape[1:][::-1], "projector": capture.sequence.panel}
    of_the_rig = {
        "camera": set(CameraOptics.model_fields) - set(CameraBeside.model_fields),
        "projector": set(ProjectorOptics.model_fields) - set(ProjectorBeside.model_fields),
    }
    for role, keys in of_the_rig.items():
        stated = tables[role].get("resolution_px")
        if stated is not None and tuple(stated) != tuple(sizes[role]):
            expected = f"{list(sizes[role])}, as the capture has"
            raise InputError(f"{path}: {role}.resolution_px", expected, stated)
        for key in keys:
            tables[role].pop(key, None)
    detector = tables["detector"]
    depth = capture.bit_depth or _FLOAT_BITS
    if detector.setdefault("bit_depth", depth) != depth:
        expected = f"{capture.bit_depth}, as the capture has"
        raise InputError(f"{path}: detector.bit_depth", expected, detector["bit_depth"])
    if not set(detector) & {"gain_e_per_dn", "full_well_e", *SheetKeys.model_fields}:
        phase = capture.decode(keep_evidence=True)
        noise, kind = noise_of(capture, phase)
        if kind == "lower bound" or noise.gain_dn_per_e == 0.0:
            raise InputError(
                "twin",
                "a camera whose noise is known: --hardware, [noise] in capture.toml, or fringes of "
                "four shifts or more",
                "none",
            )
        gain = 1.0 / noise.gain_dn_per_e
        detector |= {"gain_e_per_dn": gain, "read_noise_e": noise.read_dn * gain}
        detector.setdefault("offset_dn", max(noise.offset_dn, 0.0))
    if "gain_e_per_dn" in detector and not set(detector) & {"full_well_e", "snr_max_db"}:
        top = min(capture.top_dn, 2.0 ** detector["bit_depth"] - 1.0)
        black = detector.get("offset_dn", 0.0)
        detector["full_well_e"] = (top - black) * detector["gain_e_per_dn"]
    detector.setdefault("dark_current_e_per_s", 0.0)
    return tables


def _content(
    name: str,
    capture: Capture,
    objects: Sequence[TwinObject],
    places: Sequence[Place],
    given: Mapping[str, dict[str, Any]],
    bounces: int | None,
    samples: int,
) -> tuple[dict[str, Any], dict[str, Path]]:
    """Return a scene's content, but for its light, and the mesh files that it names."""
    from scipy.spatial.transform import Rotation

    files: dict[str, Path] = {}
    rows = []
    for one, placed in zip(objects, places, strict=True):
        shape: dict[str, Any] = {"artefact": one.shape}
        if one.shape == "plane":
            shape = {"kind": "plane", "parameters": {"size_mm": _plane_size(placed)}}
        elif Path(one.shape).suffix.lower() in SUFFIXES:
            files[Path(one.shape).name] = Path(one.shape)
            shape = {"mesh": Path(one.shape).name, "unit": one.unit}
        turn = Rotation.from_matrix(placed.pose.rotation).as_euler("XYZ", degrees=True)
        where = {"position_mm": placed.pose.position.tolist(), "rotation_deg": turn.tolist()}
        rows.append(shape | where | {"material": one.material})
    alone = all(one.shape == "plane" for one in objects) and len(objects) == 1
    light = {
        "ambient_w_per_m2": _AMBIENT_W_PER_M2,
        "bounces": (0 if alone else 2) if bounces is None else bounces,
    }
    tables = {key: dict(given[key]) for key in ("camera", "projector", "detector", "exposure")}
    tables["camera"]["shading"] = []  # fitted, as is the blur where fringes tell it
    if _has_fringes(capture):
        tables["projector"]["blur_px"] = 0.0
    return {
        "name": name,
        "description": "Twin of a scanner, by what it photographed",
        "rig": {"file": "rig.yaml"},
        **tables,
        "light": light,
        "objects": rows,
        "patterns": {"parts": capture.sequence.to_dict()["parts"]},
        "render": {"samples": samples},
    }, files


def _plane_size(placed: Place) -> list[float]:
    """Return the size of a plate that reaches as far as the points on it."""
    on_it = np.isfinite(placed.residual_mm)
    local = placed.pose.to_local(placed.truth.point[on_it])
    reach = np.abs(local[:, :2]).max(axis=0)
    return (2.0 * reach).tolist()


def write_scene(
    folder: Path, content: Mapping[str, Any], capture: Capture, files: Mapping[str, Path]
) -> None:
    """Write a twin's scene, its rig and its meshes."""
    assert capture.rig is not None
    write_rig(folder / "rig.yaml", capture.rig, capture.rig_covariance)
    for name, path in files.items():
        shutil.copyfile(path, folder / name)
    write_toml(folder / "twin.toml", content)


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
    least = float(np.quantile(averaged(np.mean(dark, axis=0), np.ones(dark[0].shape, bool)), 0.01))
    return _lifted(detector, min(least - detector.black_dn, 0.0))


def _lifted(detector: Detector, by_dn: float) -> Detector:
    """Return a detector of another black level and the same noise of every digital number."""
    black = max(detector.black_dn + by_dn, 0.0)
    more_e = (black - detector.black_dn) * detector.e_per_dn
    read_e = float(np.sqrt(max(detector.read_noise_e**2 + more_e, 0.0)))
    return replace(detector, offset_dn=black, read_noise_e=read_e, gain_e_per_dn=detector.e_per_dn)


def _has_fringes(capture: Capture) -> bool:
    return any(isinstance(part, Fringes) for part in capture.sequence.parts)


class _Fit:
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
        self.radiance = _radiance(self.transport, self.scene)
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

    def blurred(self, blur_px: float) -> _Fit:
        """Return the same with a projector that blurs."""
        rig = self.scene.rig
        scene = replace(
            self.scene, rig=rig.having(projector=replace(rig.projector, blur_px=blur_px))
        )
        return _Fit(scene, self.capture, self.out, self.mask, self.seed)

    @property
    def photons(self) -> float:
        """Photons a unit of radiance that the fitted gain means."""
        return self.light.gain * self.detector.e_per_dn / self.detector.quantum_efficiency

    def exposed(self, scene: Scene) -> _Fit:
        """Return the fit traced as the finished scene, its exposure by the same frames."""
        return _Fit(scene, self.capture, self.out, self.mask, self.seed)


def _with_light(content: Mapping[str, Any], fit: _Fit, blur: float | None) -> dict[str, Any]:
    """Return a scene's content with the light that was fitted."""
    done = {
        key: dict(value) if isinstance(value, dict) else value for key, value in content.items()
    }
    light = fit.light
    done["light"]["ambient_w_per_m2"] = light.ambient * _AMBIENT_W_PER_M2
    done["camera"]["shading"] = list(light.shading)
    detector = _lifted(fit.detector, light.black_dn)
    for key in ("offset_dn", "read_noise_e", "gain_e_per_dn"):
        done["detector"][key] = getattr(detector, key)
    if blur is not None:
        done["projector"]["blur_px"] = blur
    # Where the automatic exposure puts the lit picture at this gain.
    camera = replace(fit.scene.rig.camera, shading=light.shading)
    grid = camera.pixel_grid()
    own = camera.relative_illumination(grid) / fit.scene.rig.camera.relative_illumination(grid)
    ambient = fit.transport.ambient * own.astype(np.float32)
    marginals = {
        name: rows.scaled(np.nan_to_num(own).ravel())
        for name, rows in fit.transport.marginals.items()
    }
    shaded = replace(fit.transport, marginals=marginals, ambient=light.ambient * ambient)
    usual = replace(fit.scene.exposure, time_s=None, white_level=0.5)
    factor = shutter_for(shaded, camera, fit.detector, usual).photons
    level = 0.5 * fit.photons / factor
    if level > 1.0:
        warn_user(
            "twin",
            f"the white panel would be {level:.3g} times saturation: frames that saturate, or a "
            "gain or full well of another camera",
        )
    done["exposure"]["white_level"] = min(level, 1.0)
    return done


def _inner(mask: Mask) -> Mask:
    """Return a mask without its border, where edges and blur are seen."""
    from scipy.ndimage import binary_closing, binary_erosion

    # Single pixels that noise left out have no border.
    whole = binary_closing(mask, iterations=1) | mask
    return mask & np.asarray(binary_erosion(whole, iterations=_BORDER))


def _truth(scene: Scene) -> GroundTruth:
    from slbench.simulate.render.groundtruth import ground_truth

    return ground_truth(scene.objects, scene.rig)


def _radiance(transport: LightTransport, scene: Scene) -> Frames:
    frames = np.empty((scene.sequence.n_frames, *transport.shape), np.float32)
    for indices, radiance in radiance_batches(transport, scene.sequence, scene.rig.projector):
        frames[indices] = radiance
    return frames


def _compared(
    fit: _Fit,
    places: tuple[Place, ...],
    files: Mapping[str, Path],
    content: dict[str, Any],
    blur: float | None,
    cloud: PointCloud,
    light: Light,
    seed: int,
) -> Twin:
    """Return the twin with how far it is from the photographs."""
    scene, capture, detector = fit.scene, fit.capture, fit.detector
    shutter = shutter_for(fit.transport, scene.rig.camera, detector, scene.exposure)

    def mean_frames(radiance: Frames) -> Frames:
        return detector.expected_dn(radiance * shutter.photons, shutter.time_s).astype(np.float32)

    expected, half = mean_frames(fit.radiance), fit.transport.half()
    halved = expected if half is None else mean_frames(_radiance(half, scene))
    simulated = exposed(
        *(fit.transport, capture.sequence, scene.rig, detector, scene.exposure),
        seed=seed,
        shutter=shutter,
    )
    own = len(content["patterns"]["parts"])
    alone = replace(capture.sequence, parts=capture.sequence.parts[:own])
    decoded = decode_capture(
        replace(
            simulated,
            frames=simulated.frames[: alone.n_frames],
            sequence=alone,
            min_modulation_dn=capture.min_modulation_dn,
        )
    )
    assert decoded.cloud is not None  # there is a rig
    distances = [_distance(one, fit.truth, fit.where) for one in (cloud, decoded.cloud)]
    sensitivity = float(np.median(np.linalg.norm(cloud.sensitivity, axis=-1).min(axis=-1)))
    likeness = Likeness(
        frames=frame_likeness(
            *(capture, expected, halved, detector, scene.exposure.vibration_px),
            *(fit.where, fit.out),
        ),
        contrasts=contrast_likeness(capture, expected, fit.where, fit.out),
        noise=noise_likeness(capture, simulated, fit.where, fit.out),
        points=PointLikeness(
            photographed_mm=distances[0], simulated_mm=distances[1], mm_per_px=sensitivity
        ),
        white_dn=float(np.quantile(expected[:, fit.where].max(axis=0), 0.9)) - detector.black_dn,
    )
    return Twin(
        content=content,
        scene=replace(scene, sequence=alone),
        files=files,
        places=places,
        light=light,
        blur_px=blur,
        likeness=likeness,
        capture=capture,
        simulated=simulated,
        expected=expected,
    )


def _distance(cloud: PointCloud, truth: GroundTruth, where: Mask) -> Array:
    """Return distances of points from the surface along its normal, (V, U); NaN elsewhere."""
    columns, rows = cloud.pixels.T
    off = np.sum(truth.normal[rows, columns] * (cloud.points - truth.point[rows, columns]), axis=1)
    return np.where(where, cloud.image(off), np.nan)


def write_twin(
    twin: Twin,
    folder: str | Path,
    files: Mapping[str, Callable[[Twin, Path], None]] | None = None,
) -> None:
    """Write a twin: ``twin.toml`` and what it names, and ``twin.json``.

    Parameters
    ----------
    twin : Twin
    folder : path
    files : mapping of str to callable, optional
        What writes further files, by their names.

    Raises
    ------
    InputError
        If what slbench did not write is in the way.
    """
    with TWIN_FOLDER.writing(folder, {"scene": twin.scene.name}, None) as temporary:
        write_scene(temporary, twin.content, twin.capture, twin.files)
        write_json(temporary / "twin.json", twin.to_dict())
        for name, write in (files or {}).items():
            write(twin, temporary / name)
