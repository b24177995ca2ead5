"""Making one sample: draw until the constraints are met, trace, capture, score.

The stages are those of :func:`slbench.simulate.scan.scan`; the light is traced once for all pattern
sets and repeats.  A sample's bytes follow from specification, seed, index and what
:func:`environment` names: nothing in them tells the time, the host or the number of threads.
(Every stage sums in an order that threads do not change; linear algebra, whose libraries may, is
held to one thread.)  The kind of processor does matter: BLAS and NumPy have kernels of their own
for each, whose last bits differ.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
import scipy.linalg  # noqa: F401  (its BLAS is among those that environment() names)
from threadpoolctl import threadpool_info, threadpool_limits

from slbench.core.errors import InputError
from slbench.core.io import provenance, write_json, write_png
from slbench.core.io.scratch import temporary_folder
from slbench.datasets.spec.sampling import (
    Draw,
    capture_seed,
    draw,
    outside_volume,
    place_scene,
    sample_seed,
)
from slbench.datasets.spec.specification import Specification
from slbench.datasets.store.index import OK, SCORES, STATISTICS
from slbench.datasets.store.sample import (
    INSTANCES,
    PROVENANCE,
    SCORE,
    TRANSPORT,
    TRUTH,
    capture_names,
    from_folder,
    rounded,
    write_capture,
    write_transport,
)
from slbench.datasets.store.shards import digest, key
from slbench.patterns.ripple import ripple_rms_px, ripples
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth, Status
from slbench.score.points import score
from slbench.simulate.expose import capture
from slbench.simulate.floors import Floor, floor_of
from slbench.simulate.reconstruct import reconstruct
from slbench.simulate.transport import LightTransport, Marginal

#: Why draws are rejected.
BUILD, VOLUME, DARK = "cannot be built", "outside the volume", "too few lit pixels"
REJECTIONS = (BUILD, VOLUME, DARK)
_WRITERS = ("OpenEXR", "matplotlib")


class NothingPassesError(Exception):
    """No draw of a sample met the constraints; another attempt would find the same."""


def environment() -> dict[str, Any]:
    """Return what samples depend on beside the specification.

    Versions of libraries, Mitsuba's variant, and what the libraries make of the processor: the
    kernels that BLAS and NumPy choose for it.

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    """
    from slbench.simulate.render.backend.choice import current

    made = provenance({}, None)
    kept = {name: made[name] for name in ("slbench", "python", "libraries")}
    # Beside those of any result: the glyphs of coins, and what compresses truth and transport.
    kept["libraries"] |= {name: importlib.metadata.version(name) for name in _WRITERS}
    kept["libraries"] |= {"zlib": zlib.ZLIB_RUNTIME_VERSION} | _kernels()
    return {**kept, "variant": current().variant}


def _kernels() -> dict[str, str]:
    """Return the kernels of linear algebra and of NumPy that serve this processor."""
    pools = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    blas = {pool["architecture"] for pool in pools if "architecture" in pool}  # MKL says none
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]  # type: ignore[index]
    return {
        "BLAS kernels": " ".join(sorted(blas)),
        "NumPy kernels": " ".join((*extensions["baseline"], *extensions.get("found", ()))),
    }


def make_sample(
    specification: Specification,
    files: Mapping[str, bytes],
    seed: int,
    sample: int,
    *,
    preview: bool = False,
    made_with: Mapping[str, Any] | None = None,
) -> dict[str, bytes]:
    """Make one sample.

    Parameters
    ----------
    specification, files
        As :func:`slbench.datasets.spec.specification.load` gives them.
    seed, sample : int
        Seed of the data set, index of the sample.
    preview : bool
        Fewer camera pixels and Monte Carlo samples.
    made_with : mapping, optional
        The :func:`environment`, if it is at hand.

    Returns
    -------
    dict of str to bytes
        Its members (:mod:`slbench.datasets.store.sample`).

    Raises
    ------
    NothingPassesError
        If no draw met the constraints.
    InputError, BackendError
        If it cannot be rendered or scored.
    """
    own_seed = sample_seed(seed, sample)
    rejected = dict.fromkeys(REJECTIONS, 0)
    problem = ""
    for number in range(specification.constraints.max_draws):
        drawn = draw(specification, seed, sample, number)
        with temporary_folder("sample") as folder:
            try:
                scene = place_scene(drawn, files, folder, preview)
            except InputError as error:
                rejected[BUILD] += 1
                problem = f"{BUILD} ({error})"
                continue
            inside = specification.constraints.inside_volume
            if inside and outside_volume(scene, drawn.wanted):
                rejected[VOLUME] += 1
                problem = VOLUME
                continue
            truth = _truth(scene)
            if _too_dark(truth, specification.constraints.min_lit_share, drawn.wanted):
                rejected[DARK] += 1
                problem = DARK
                continue
            scores = _measure(specification, scene, truth, own_seed, folder, drawn.wanted)
            scores["object"] = _object_hash(scene)
            write_json(folder / SCORE, scores)
            record = _record(specification, drawn, own_seed, rejected)
            write_json(folder / PROVENANCE, {**(made_with or environment()), **record})
            return from_folder(folder)
    draws = specification.constraints.max_draws
    raise NothingPassesError(f"none of {draws} draws met the constraints, the last: {problem}")


def _truth(scene: Scene) -> GroundTruth:
    from slbench.simulate.render.groundtruth import ground_truth

    return ground_truth(scene.objects, scene.rig)


def _too_dark(truth: GroundTruth, share: float, wanted: int) -> bool:
    """Return whether too few pixels see the first objects lit; one is always needed."""
    return _seen_lit(truth, wanted) < max(1.0, share * truth.lit.size)


def _seen_lit(truth: GroundTruth, wanted: int) -> int:
    """Return how many pixels see one of the first objects lit."""
    first = (truth.object_id >= 0) & (truth.object_id < wanted)
    return int(np.count_nonzero(truth.lit & first))


def _measure(
    specification: Specification,
    scene: Scene,
    truth: GroundTruth,
    seed: int,
    folder: Path,
    wanted: int,
) -> dict[str, Any]:
    """Trace, capture and score; write transport, truth and frames; return the scores."""
    from slbench.simulate.render.trace import trace

    scenes = {prefix: patterns.of(scene, folder) for prefix, patterns in specification.prefixes()}
    # Frames are made of what is stored, so that anyone can make them again.
    marginals = marginals_of(specification, scene, folder)
    parts = scene.objects, scene.rig, scene.light
    traced = trace(*parts, marginals, samples=scene.samples, seed=seed)
    transport = rounded(traced, specification.weight_bits)
    if any(block.data.size == 0 for block in transport.marginals.values()):
        raise InputError("light transport", "light on the object", "none")
    write_transport(folder / TRANSPORT, transport)
    truth.save(folder / TRUTH, scene.rig)
    if specification.has_instances:
        write_png(folder / INSTANCES, truth.instances)
    captures: dict[str, Any] = {}
    floors: dict[int, Floor] = {}
    for prefix, posed in scenes.items():
        pattern_set, repeat = (int(n) for n in prefix[1:].split("r"))
        own = capture_seed(seed, pattern_set, repeat)
        shots = capture(
            transport, posed.sequence, posed.rig, posed.detector, posed.exposure, seed=own
        )
        write_capture(folder, prefix, shots)
        with threadpool_limits(1, "blas"):
            phase = shots.decode()
            if repeat == 0:
                floors[pattern_set] = floor_of(
                    transport, posed.sequence, posed.rig.projector, truth
                )
            floor = floors[pattern_set]
            cloud = reconstruct(posed, phase, seed=own).cloud
            cloud = cloud.with_steady(floor.sampling_px)
            cloud = cloud.with_steady(ripple_rms_px(ripples(phase, posed.sequence)))
            result = score(cloud, truth, phase, posed.objects, posed.rig)
        captures[prefix] = {
            "patterns": posed.sequence.name,
            "frames": posed.sequence.n_frames,
            "seed": own,
            **result.to_dict(),
            "floor_rms_px": floor.rms_px,
            "monte_carlo_rms_px": floor.sampling_rms_px,
        }
    return {"statistics": _statistics(transport, truth, wanted), "captures": captures}


def marginals_of(specification: Specification, scene: Scene, folder: Path) -> tuple[Marginal, ...]:
    """Return the marginals of the light transport that samples keep; pictures are in the folder."""
    if specification.marginals:
        return specification.marginals
    scenes = [patterns.of(scene, folder) for patterns in specification.patterns]
    needed = {along for one in (scene, *scenes) for along in one.sequence.variations}
    return tuple(along for along in get_args(Marginal) if along in needed)


def _statistics(transport: LightTransport, truth: GroundTruth, wanted: int) -> dict[str, Any]:
    lit = truth.lit
    depth = truth.depth[lit]
    return {
        "lit_pixels": int(np.count_nonzero(lit)),
        "object_pixels": _seen_lit(truth, wanted),
        "shadowed_pixels": int(np.count_nonzero(truth.status == Status.SHADOWED)),
        "depth_min_mm": float(depth.min()),
        "depth_max_mm": float(depth.max()),
        "transport_entries": int(sum(rows.data.size for rows in transport.marginals.values())),
    }


def _object_hash(scene: Scene) -> str:
    """Return a hash of the first object's shape, which tells equal objects."""
    mesh = scene.objects[0].artefact.mesh
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()[:16]


def _record(
    specification: Specification, drawn: Draw, seed: int, rejected: Mapping[str, int]
) -> dict[str, Any]:
    parameters = {
        "specification": specification.name,
        "kind": drawn.kind,
        "drawn": drawn.values,
        "draws": 1 + sum(rejected.values()),
        "rejected": dict(rejected),
    }
    return {"seed": seed, "parameters": parameters}


def row_of(sample: int, members: Mapping[str, bytes]) -> dict[str, Any]:
    """Return a sample's row of the index, but for where it stands.

    The row follows from the members, so an index can be made again from its shards.
    """
    scores = json.loads(members[SCORE])
    record = json.loads(members[PROVENANCE])
    parameters = record["parameters"]
    row: dict[str, Any] = {
        "sample": sample,
        "key": key(sample),
        "status": OK,
        "attempts": 1,
        "kind": parameters["kind"],
        "object": scores["object"],
        "seed": record["seed"],
        "draws": parameters["draws"],
        **parameters["drawn"],
        **{name: scores["statistics"][name] for name in STATISTICS},
    }
    for prefix in capture_names(members):
        result = scores["captures"][prefix]
        row |= {f"{prefix}_{name}": result[name] for name in SCORES}
    return row


def stamped(row: Mapping[str, Any], content: bytes) -> dict[str, Any]:
    """Return a row with the size and the hash of the sample's bytes."""
    return {**row, "size": len(content), "sha256": digest(content)}
