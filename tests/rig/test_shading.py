"""The brightness of a picture from its middle to its corners."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.rig.opencv import read_rig, write_rig
from slbench.scene import load_scene
from slbench.simulate.stack import traced


def test_shading_is_the_polynomial_times_the_natural_fall_off() -> None:
    camera = load_scene("plane").rig.camera
    shaded = replace(camera, shading=(0.02, 0.0, -0.3, 0.0, -0.1))
    corner = np.array([[-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5]])
    plain = camera.relative_illumination(corner)
    expected = plain * (1.0 + np.array([-0.02, 0.02]) - 0.3 - 0.1)
    assert shaded.relative_illumination(corner) == pytest.approx(expected, abs=1e-15)
    middle = [[(camera.width - 1) / 2, (camera.height - 1) / 2]]
    assert shaded.relative_illumination(middle) == pytest.approx(
        camera.relative_illumination(middle), abs=1e-15
    )


def test_a_coarser_camera_has_the_same_shading() -> None:
    camera = replace(load_scene("plane").rig.camera, shading=(0.1, -0.1, 0.0, 0.2, -0.3))
    coarse = camera.coarser(4)
    # The middle of a coarse pixel is that of the four by four.
    fine = camera.relative_illumination([[4 * 20 + 1.5, 4 * 11 + 1.5]])
    assert coarse.relative_illumination([[20, 11]]) == pytest.approx(fine, rel=1e-12)


def test_the_renderer_shades_light_and_surroundings() -> None:
    given = ["camera.shading=[0, 0, -0.4, 0, -0.4]", "light.ambient_w_per_m2=1"]
    plain = load_scene("plane", preview=True, changes=given[1:])
    shaded = load_scene("plane", preview=True, changes=given)
    (one,), (other,) = traced(plain, seed=3), traced(shaded, seed=3)
    grid = plain.rig.camera.pixel_grid()
    expected = shaded.rig.camera.relative_illumination(grid)
    expected = expected / plain.rig.camera.relative_illumination(grid)
    # Weights are kept to single precision's bits, of which some are rounded away.
    assert other.white() == pytest.approx(one.white() * expected, rel=2e-3)
    assert other.ambient == pytest.approx(one.ambient * expected, rel=1e-5)
    assert other.ambient.max() > 0.0


def test_a_rig_file_keeps_shading(tmp_path) -> None:
    rig = load_scene("plane").rig
    camera = replace(rig.camera, shading=(0.0, 0.0, -0.25, 0.1, -0.125))
    write_rig(tmp_path / "rig.yaml", rig.having(camera=camera))
    assert read_rig(tmp_path / "rig.yaml").camera.shading == camera.shading


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ((0.0, 0.0, -0.6, 0.0, -0.5), "above 0 all over the picture, got -0.1"),
        ((0.1, 0.2, 0.3), "shading: expected"),
    ],
)
def test_shading_that_is_none_is_refused(given, expected) -> None:
    camera = load_scene("plane").rig.camera
    with pytest.raises(InputError, match=expected):
        replace(camera, shading=given)
