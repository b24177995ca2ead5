"""Stated intervals of acceptance tests hold the long-run value as often as they say.

Light is traced once, so that what its samples leave is the same in all and no part of the intervals
here.  Of each virtual acceptance test the measuring rig, drawn from a calibration's covariance, and
the noise are new.  Cameras are cropped to the rows of each standard.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numba
import numpy as np
import pytest

from slbench.bench.accept.acceptance import planned, with_sampling
from slbench.bench.accept.signatures import calibration_draws
from slbench.bench.accept.virtual import Light, light_of, measure
from slbench.rig.parameters import ParameterCovariance, moved
from slbench.scene.file import load_scene
from slbench.simulate.lights import Lights

#: Places of each standard: in many virtual acceptance tests, and in a hundred quick ones.
MANY, FEW = {"sphere": 3, "ball_bar": 2, "plane": 2}, {"sphere": 1, "ball_bar": 1}
#: A calibration of boards: parts of a pixel, tenths of a milliradian; two errors go together.
DEVIATIONS = {
    "camera.fx_px": 0.3,
    "camera.k1": 0.01,
    "projector.cx_px": 0.3,
    "projector.ry_rad": 1e-4,
    "projector.tx_mm": 0.1,
}


def covariance() -> ParameterCovariance:
    own = ParameterCovariance.of(DEVIATIONS)
    matrix = own.matrix.copy()
    i, j = (own.names.index(name) for name in ("projector.cx_px", "projector.ry_rad"))
    matrix[i, j] = matrix[j, i] = 0.8 * np.sqrt(matrix[i, i] * matrix[j, j])
    return replace(own, matrix=matrix)


def cropped(light: Light) -> Light:
    """The same light in the rows of the camera that the standard is in, without its halves."""
    scenes, transports, pixels = [], [], []
    for k, scene in enumerate(light.scenes):
        rows = np.flatnonzero(np.any(light.pixels[k], axis=(0, 2)))
        own = slice(max(int(rows[0]) - 1, 0), int(rows[-1]) + 2)
        camera = scene.rig.camera
        u, v = camera.centre
        smaller = replace(camera, height=own.stop - own.start, principal_point=(u, v - own.start))
        rig = scene.rig.having(**{scene.rig.only.camera: smaller})
        scenes.append(replace(scene, rig=rig))
        transports.append(tuple(one.band(own) for one in light.transports[k]))
        pixels.append(tuple(one[own] for one in light.pixels[k]))
    halves = ({},) * len(scenes)
    return Light(light.place, tuple(scenes), tuple(transports), tuple(pixels), halves)


@pytest.fixture(autouse=True)
def one_thread():
    """Arrays of a few hundred points are not worth a second thread."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)


@functools.cache
def lights(few: bool) -> list[Light]:
    scene = replace(load_scene("acceptance-macro", preview=True), samples=128)
    stored, counts = Lights(0, kept=1), FEW if few else MANY
    places = planned(scene, kinds=tuple(counts), counts=counts)
    return [cropped(light_of(scene, place, stored)) for place in places]


def acceptances(count: int, few: bool) -> dict[str, list[list[tuple[float, float]]]]:
    """Return error and half interval of each test, draw by draw and place by place, mm."""
    known = covariance()
    found: dict[str, list[list[tuple[float, float]]]] = {}
    for k in range(count):
        error = known.draw(1000 + k)
        values = []
        for n, light in enumerate(lights(few)):
            rig = moved(light.scenes[0].rig, error)
            measured = measure(light, seed=100 * k + n, rig=rig)
            values += measured.values(calibration_draws(rig, measured, ("u",), known))
        rows: dict[str, list[tuple[float, float]]] = {}
        for value in with_sampling(values):
            low, high = value.interval_mm
            rows.setdefault(value.test, []).append((value.error_mm, 0.5 * (high - low)))
        for name, row in rows.items():
            found.setdefault(name, []).append(row)
    return found


@pytest.mark.parametrize(
    ("count", "few", "least", "most"),
    [
        # Of 100 tests a share of 95 % is known to 2.2 %: 89 to 99 % are three of that.
        pytest.param(100, True, 0.89, 0.99, id="100"),
        # Of 1,000 to 0.7 %.
        pytest.param(
            1000,
            *(False, 0.93, 0.97),
            id="1000",
            marks=[pytest.mark.statistics, pytest.mark.timeout(3600)],
        ),
    ],
)
def test_intervals_hold_the_long_run_value(
    count: int, few: bool, least: float, most: float
) -> None:
    for name, draws in acceptances(count, few).items():
        errors, halves = np.moveaxis(np.array(draws), -1, 0)
        held = np.abs(errors - errors.mean(axis=0)) <= halves
        assert least <= held.mean() <= most, (name, held.mean(axis=0))
