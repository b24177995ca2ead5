"""Folders of photographs of several cameras, as people make them, of a ball before a plate."""

import numpy as np
import tomli_w
from several_cameras import PANEL, Ball, Plate, camera_at, projector_at, truth

from slbench.core.io import write_png
from slbench.patterns import PatternSequence
from slbench.rig import Pair, Rig
from slbench.rig.opencv import write_rig

BALL = [Ball(60.0, -60.0), Plate(-30.0)]
CAMERA = {"size": (80, 60), "pitch": 0.03}
RIG = Rig(
    {"left": camera_at(-120.0, **CAMERA), "right": camera_at(120.0, **CAMERA)},
    {"main": projector_at(0.0)},
)
FRINGES = {
    "panel": list(PANEL),
    "parts": [{"kind": "fringes", "count": n, "shifts": 4} for n in (1, 6, 24)],
}
SPECKLE = {"panel": list(PANEL), "parts": [{"kind": "speckle", "frames": 4, "grain_px": 14.0}]}


def pictures(camera, patterns=FRINGES, seed=0):
    """Return what a camera photographs of patterns along u: 8 bit, with noise."""
    points, lit = truth(RIG, Pair(camera, "main"), BALL)
    u = RIG.projectors["main"].project(np.nan_to_num(points))[..., 0]
    rng = np.random.default_rng([seed, len(camera)])
    found = []
    for frame in PatternSequence.from_dict(patterns).frames():
        profile = frame.part.profile(frame.index, PANEL[0])
        grey = np.where(lit, 20.0 + 200.0 * np.interp(u, np.arange(PANEL[0]), profile), 3.0)
        found.append(np.clip(np.rint(grey + rng.normal(0.0, 0.8, grey.shape)), 0, 255))
    return np.array(found).astype(np.uint8)


def photograph(root, patterns=FRINGES, rig=RIG):
    """Write a sub-folder a camera, one manifest and one rig, and that of the cameras alone."""
    root.mkdir(exist_ok=True)
    for name in RIG.cameras:
        (root / name).mkdir()
        for n, frame in enumerate(pictures(name, patterns)):
            write_png(root / name / f"{n:02d}.png", frame)
    write_rig(root / "rig.yaml", rig)
    write_rig(root / "cameras.yaml", Rig(RIG.cameras, {}))
    write_manifest(root, patterns=patterns)


def write_manifest(root, name="capture.toml", **changes):
    """Write a manifest with some of its keys changed, or left out where they are None."""
    tables = [{"camera": camera, "frames": f"{camera}/*.png"} for camera in RIG.cameras]
    manifest = {"rig": "rig.yaml", "patterns": FRINGES, "pairs": tables} | changes
    kept = {key: value for key, value in manifest.items() if value is not None}
    (root / name).write_text(tomli_w.dumps(kept))
    return root / name
