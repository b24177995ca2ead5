"""The twin: a scene that stands for a real scanner and what it photographed, and how well it does.

The object is placed by the measured cloud.  Brightness, ambient light and the projector's blur
beside what the rig's apertures make are fitted to some of the frames; the others, which nothing was
fitted to, are simulated and compared.  The scene is an ordinary one: everything that runs on a
scene runs on it.
"""

from __future__ import annotations

import re
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.cloud.decoded import decode_capture
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError, InputWarning, located, warn_user
from slbench.core.io import OutputFolder, write_exr, write_json
from slbench.core.show.display import block
from slbench.core.show.drawing import figure
from slbench.objects import Artefact
from slbench.objects.mesh.file import SUFFIXES
from slbench.scene.file import load_scene
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.expose import capture as exposed
from slbench.simulate.expose import shutter_for
from slbench.twin.content import (
    AMBIENT_W_PER_M2,
    TwinObject,
    has_fringes,
    twin_content,
    write_scene,
)
from slbench.twin.fit import Fit, radiance_of, with_light
from slbench.twin.hardware import hardware_tables
from slbench.twin.light import Light
from slbench.twin.likeness import (
    Likeness,
    PointLikeness,
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
    (
        *("twin.toml", "twin.json", "twin.png", "differences.exr", "rig.yaml"),
        *(f"*{one}" for one in SUFFIXES),
    ),
)
#: Samples a pixel, by default.
SAMPLES = 64
#: Share of the points that may lie on no object.
_UNEXPLAINED = 0.2


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
        fitted["ambient_w_per_m2"] = self.light.ambient * AMBIENT_W_PER_M2
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
        For a capture without a rig, of colour pictures or several exposures; objects that are not
        where the points are; hardware of another camera.

    Warns
    -----
    InputWarning
        If many points lie on no object, or the fitted exposure saturates.
    """
    report = on_progress or (lambda stage, fraction: None)
    if capture.rig is None:
        raise InputError("twin", "a capture with its rig (--rig)", "none")
    for one in (capture, *held_out):
        if one.sequence.crosstalk is not None or one.pictures is not None:
            raise InputError("twin", "grey frames", "colour pictures (crosstalk)")
        one.one_exposure("twin")
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
    content, files = twin_content(name, capture, objects, places, given, bounces, samples)
    with tempfile.TemporaryDirectory() as folder:
        write_scene(Path(folder), content, capture, files)
        with warnings.catch_warnings(), located(f"twin of {hardware}" if hardware else "twin"):
            # Of the rig it was said when it was read.
            warnings.filterwarnings("ignore", re.escape(folder), InputWarning)
            base = load_scene(Path(folder) / "twin.toml")
        report("trace", 0.0)
        fit = Fit(base, every, out, decoded.phase.mask, seed)
        blur = None
        if has_fringes(capture):
            blur = fit.lacking_blur()
            if blur:
                report("trace", 0.5)
                fit = fit.blurred(blur)
        content = with_light(content, fit, blur)
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
    joined = np.concatenate(frames)
    return replace(capture, frames=joined, sequence=sequence, pictures=None)


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


def _compared(
    fit: Fit,
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
    halved = expected if half is None else mean_frames(radiance_of(half, scene))
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
            response=capture.response,
        )
    )
    assert decoded.cloud is not None  # there is a rig
    distances = [_distance(one, fit.truth, fit.where) for one in (cloud, decoded.cloud)]
    frames, chi_square_map = frame_likeness(
        *(capture, expected, halved, detector, scene.exposure.vibration_px),
        *(fit.where, fit.out),
    )
    likeness = Likeness(
        frames=frames,
        contrasts=contrast_likeness(capture, expected, fit.where, fit.out),
        noise=noise_likeness(capture, simulated, fit.where, fit.out),
        points=PointLikeness(photographed_mm=distances[0], simulated_mm=distances[1]),
        white_dn=float(np.quantile(expected[:, fit.where].max(axis=0), 0.9)) - detector.black_dn,
        chi_square_map=chi_square_map,
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
    """Write a twin: ``twin.toml`` and what it names, ``twin.json``, and ``differences.exr``.

    The last has pixel by pixel ``chi_square`` of the held-out frames, and the distances from the
    object of ``photographed_mm`` and ``simulated_mm`` points.

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
        points = twin.likeness.points
        maps = {
            "chi_square": twin.likeness.chi_square_map,
            "photographed_mm": points.photographed_mm,
            "simulated_mm": points.simulated_mm,
        }
        single = {name: values.astype(np.float32) for name, values in maps.items()}
        write_exr(temporary / "differences.exr", single)
        for name, write in (files or {}).items():
            write(twin, temporary / name)
