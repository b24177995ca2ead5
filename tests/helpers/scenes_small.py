"""Small scenes for the system tests, and their traced transports, made once a session.

A shipped scene's camera with fewer, larger pixels; field of view, aperture and panel stay.
"""

import contextlib
import functools
import io
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w
from stages import ground_truth, trace

from slbench import objects
from slbench.cli import main
from slbench.rig import Pose
from slbench.scene.file import load_scene
from slbench.scene.model import Scene, SceneObject
from slbench.scene.surfaces.bsdfs import Diffuse
from slbench.scene.surfaces.materials import Material
from slbench.scene.truth import GroundTruth
from slbench.simulate.transport import LightTransport


def small(
    name: str,
    patterns: str = "1,10,50",
    shifts: int = 3,
    axes: str = "u",
    divisor: int = 4,
    samples: int = 16,
) -> Scene:
    """Return a shipped scene with a camera of 640 / divisor x 480 / divisor pixels."""
    scene = load_scene(name).coarser(divisor, samples)
    return scene.with_patterns(patterns, shifts, axes)


def scene_of(items: Iterable[SceneObject], divisor: int = 4, samples: int = 16) -> Scene:
    """Return the plane's scene with other objects."""
    return replace(small("plane", divisor=divisor, samples=samples), objects=tuple(items))


def at(artefact: objects.Artefact, *position: float, albedo: float = 0.8) -> SceneObject:
    """Return an artefact at a position, unturned."""
    return SceneObject(
        artefact, Pose(np.eye(3), np.array(position or (0, 0, 0))), Material(Diffuse(albedo=albedo))
    )


@functools.cache
def transport_of(name: str, axes: str = "u", samples: int = 16) -> LightTransport:
    """Return the transport of :func:`small`, traced once a session."""
    return trace(small(name, axes=axes, samples=samples), seed=0)


@functools.cache
def truth_of(name: str) -> GroundTruth:
    """Return the ground truth of :func:`small`, computed once a session."""
    return ground_truth(small(name))


#: A scene of 160 x 120 camera pixels as a file says it; everything else is the shipped rig's.
SMALL_FILE = {
    "extends": "hardware/macro-ch6",
    "name": "small",
    "camera": {"resolution_px": [160, 120], "pitch_um": 29.6},
    "objects": [{"artefact": "step-block-5", "material": "matt-white-spray"}],
    "render": {"samples": 16},
}


def write_scene(folder: Path, **changes: Any) -> str:
    """Write :data:`SMALL_FILE`, some keys changed, and return its path."""
    path = folder / "small.toml"
    path.write_text(tomli_w.dumps(SMALL_FILE | changes))
    return str(path)


class Outcome(NamedTuple):
    """What a command did."""

    status: int
    out: str
    err: str


def run_cli(*arguments: object) -> Outcome:
    """Run the command line in this process."""
    out, err = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["slbench", *map(str, arguments)]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                main()
            except SystemExit as end:
                status = end.code
    finally:
        sys.argv = before
    assert isinstance(status, int)
    return Outcome(status, out.getvalue(), err.getvalue())


def check_refused(outcome: Outcome, *words: str) -> None:
    """Check that a command refused its input: one line with the words, nothing printed."""
    assert outcome.status == 2
    assert outcome.out == ""
    assert len(outcome.err.splitlines()) == 1
    assert outcome.err.startswith("error: ")
    for word in words:
        assert word in outcome.err
