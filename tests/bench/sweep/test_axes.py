"""What a sweep goes through: ranges, lists, and what is neither."""

import numpy as np
import pytest

from slbench.bench.sweep.axes import read_axes
from slbench.core.errors import InputError


@pytest.mark.parametrize(
    ("text", "values", "scale"),
    [
        ("camera.f_number=4:16:5", (4, 7, 10, 13, 16), "linear"),
        ("camera.f_number=16:4:3", (16, 10, 4), "linear"),
        ("camera.f_number=4:64:5log", (4, 8, 16, 32, 64), "log"),
        ("camera.f_number=1e-1 : .3 : 3", (0.1, 0.2, 0.3), "linear"),
        ("camera.f_number=4,8,16", (4, 8, 16), "linear"),
        ("camera.f_number=[4, 8.5]", (4, 8.5), "linear"),
        ("exposure.time_ms=10:30:3", (10, 20, 30), "linear"),  # no time of day
        ("exposure.time_ms=10:20:30", tuple(np.linspace(10, 20, 30).round(10)), "linear"),
        ("light.bounces=0:4:3", (0, 2, 4), "linear"),
        ("focus.move=camera,projector", ("camera", "projector"), "linear"),
        ('patterns.sequence=["1,10,50", "gray"]', ("1,10,50", "gray"), "linear"),
        (
            "objects[0].position_mm=[0, 0, 1],[0, 0, 2]",
            ([0, 0, 1], [0, 0, 2]),
            "linear",
        ),
        ("objects[0].position_mm[2]=-1:1:3", (-1, 0, 1), "linear"),
        ("camera.pitch_um=[7.4, 7.4],[8, 8]", ([7.4, 7.4], [8, 8]), "linear"),
        ("detector.full_well_e=1000:4000:2", (1000, 4000), "linear"),
        ("camera.natural_vignetting=true,false", (True, False), "linear"),
    ],
)
def test_values(text, values, scale):
    fixed, (axis,) = read_axes([text])
    assert fixed == ()
    assert axis.scale == scale
    assert axis.key == text.partition("=")[0]
    if axis.numbers:
        np.testing.assert_allclose(axis.values, values, rtol=1e-9)
        assert all(type(a) is int for a, b in zip(axis.values, values, strict=True) if b % 1 == 0)
    else:
        assert axis.values == values


def test_one_value_is_the_same_in_all():
    fixed, axes = read_axes(
        ["light.bounces=2", "camera.f_number=4,8", "objects[0].position_mm=[0,0,1]"]
    )
    assert [one.key for one in fixed] == ["light.bounces", "objects[0].position_mm"]
    assert [axis.key for axis in axes] == ["camera.f_number"]


def test_python_gives_lists_and_arrays():
    given = {
        "camera.f_number": np.array([4.0, 8.0]),
        "objects[0].position_mm": [0.0, 0.0, 1.0],
        "patterns.sequence": ("1,4", "1,8"),
        "patterns.shifts": 4,
    }
    fixed, axes = read_axes(given)
    assert [axis.values for axis in axes] == [(4.0, 8.0), ("1,4", "1,8")]
    assert [change.value for change in fixed] == [(0.0, 0.0, 1.0), 4]


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["camera.f_number=8"], "camera.f_number=8"),
        (["patterns.sequence=1,10,50"], "start:stop:count"),
        ([], "none"),
        (["camera.f_number"], "start:stop:count"),
        (["camera.f_number=4:16"], "'4:16'"),
        (["camera.f_number=4:16:5:6"], "'4:16:5:6'"),
        (["camera.f_number=4:16:5lin"], "'4:16:5lin'"),
        (["camera.f_number=4:16:1"], "2 to 10000 values"),
        (["camera.f_number=4:16:0"], "2 to 10000 values"),
        (["camera.f_number=4:4:3"], "two ends"),
        (["camera.f_number=0:16:3log"], "positive ends"),
        (["camera.f_number=-4:16:3log"], "positive ends"),
        (["camera.f_number=[]"], "an empty list"),
        (["camera.f_number=4,8", "camera.f_number=2,3"], "each key once"),
        (["camera.f_number=1:2:200", "camera.blur_px=0:1:200"], "at most 10000 combinations"),
        (["camera f=1,2"], "key=value"),
    ],
)
def test_refused(texts, words):
    with pytest.raises(InputError) as caught:
        read_axes(texts, "--set")
    assert caught.value.where.startswith("--set")
    assert words in str(caught.value)
