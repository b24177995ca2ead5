"""The budget of planning views: 200 candidates of a part of 100,000 triangles within a minute.

On two cores that do nothing else; the time is printed, with what else the machine did.
"""

import os
import time

import numpy as np
import pytest
import trimesh
from view_parts import part_scene

from slbench import objects
from slbench.design.views.candidates import Staging
from slbench.design.views.plan import plan_views
from slbench.objects import Artefact, Mesh
from slbench.simulate.viewpoints.views import Counting

pytestmark = pytest.mark.slow  # some 20 s

LIMIT_S = 60.0


def test_200_candidates_of_100_000_triangles(capsys):
    mesh = objects.load_artefact("engine-block").mesh
    vertices, faces = trimesh.remesh.subdivide(mesh.vertices, mesh.faces)
    vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    assert len(faces) > 100_000
    part = Artefact("fine-block", "mesh", {}, Mesh(np.asarray(vertices), np.asarray(faces)), {})
    scene = part_scene(part, divisor=1)
    used, begin = time.process_time(), time.perf_counter()
    plan = plan_views(scene, 8, staging=Staging(count=200), counting=Counting(max_std_mm=0.04))
    took, used = time.perf_counter() - begin, time.process_time() - used
    with capsys.disabled():
        print(
            f"\n{len(faces)} triangles, {len(plan.candidates)} candidates, {plan.samples} samples: "
            f"{took:.1f} s, {used:.1f} s of processors; {dict(plan.seconds)}; load "
            f"{os.getloadavg()[0]:.1f}"
        )
    assert len(plan.candidates) >= 190
    # Where others use the processors too, what counts is what two of them would have taken.
    assert min(took, used) < LIMIT_S
