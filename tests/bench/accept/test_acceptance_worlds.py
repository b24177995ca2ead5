"""Acceptance by a rig whose world is not that of the standard's poses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds import in_another_world

from slbench.bench.accept.acceptance import planned
from slbench.bench.accept.virtual import light_of, measure
from slbench.rig import Pose
from slbench.scene.calibration import Calibration
from slbench.scene.file import load_scene
from slbench.simulate.lights import Lights

OTHER = Pose(Rotation.from_rotvec([0.9, -1.4, 0.5]).as_matrix(), np.array([60.0, -30.0, 400.0]))


@pytest.fixture(scope="module")
def light():
    """Two views of a ball, in few samples."""
    scene = replace(load_scene("acceptance-macro", preview=True), samples=4)
    place = planned(scene, kinds=("sphere",), counts={"sphere": 1}, views=2)[0]
    return light_of(scene, place, Lights(0, kept=1))


@pytest.mark.parametrize("align", [None, False, True])
def test_views_by_poses_do_not_depend_on_the_world_of_the_rig(light, align):
    """A rig in another world, handed over or as a calibration, aligned or not.

    Frames are joined by exact places: rounding is left, 1e-6 mm at 400 mm.
    """
    own = measure(light).errors()
    rig = in_another_world(light.scenes[0].rig, OTHER)
    if align is None:
        found = measure(light, rig=rig).errors()
    else:
        made = Calibration(rig=rig, align=align)
        scenes = tuple(replace(scene, calibration=made) for scene in light.scenes)
        found = measure(replace(light, scenes=scenes)).errors()
    assert found == pytest.approx(own, abs=1e-6)
