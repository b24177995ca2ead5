"""No step of the interpreter in loops over pixels: calls do not grow with the picture."""

import cProfile
import pstats

import pytest
from stages import capture, trace

from slbench.scene.file import load_scene


def calls(function):
    """Return what a function gives, and how many calls of the interpreter it took."""
    profile = cProfile.Profile()
    given = profile.runcall(function)
    return given, pstats.Stats(profile).total_calls


@pytest.mark.parametrize("stream", ["pcg64", "philox4x32"])
def test_calls_do_not_grow_with_pixels(stream):
    """A step a row would be 240 calls more, a step a pixel 230,400; both have all threads at work.

    Tracing goes in passes that memory bounds: a hundredth of a call a pixel is left for them.
    """
    counts = []
    for size in ([320, 240], [640, 480]) * 2:  # the first two compile, load and tabulate
        changes = {
            "camera.resolution_px": size,
            "camera.pitch_um": 7.4 * 640 / size[0],
            "detector.noise_stream": stream,
        }
        scene = load_scene("plane", changes=changes)
        light, traced = calls(lambda scene=scene: trace(scene, seed=0))
        _, exposed = calls(lambda scene=scene, light=light: capture(scene, light, seed=1))
        counts.append((traced, exposed))
    small, large = counts[2:]
    assert large[1] - small[1] < 240
    assert large[0] - small[0] < 2_400
