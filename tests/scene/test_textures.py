"""Textures: drawn ones are what their parameters say, pictures one band of light, slips refused."""

import re

import cv2
import numpy as np
import pytest

from slbench import objects
from slbench.core.colour import LUMINANCE, decode_srgb, luminance
from slbench.core.errors import InputError
from slbench.objects.surface import Pixels
from slbench.scene.drawn import Checker, Noise, Spots, Stripes, Text
from slbench.scene.file import load_scene
from slbench.scene.model import SceneObject
from slbench.scene.surfaces.bsdfs import Diffuse, RoughPlastic
from slbench.scene.surfaces.materials import Material
from slbench.scene.surfaces.textures import OfMesh, Picture
from slbench.simulate.lights import light_key

SCENE = """
extends = "plane"
name = "textured"
[[objects]]
kind = "plane"
parameters = { size_mm = [100.0, 100.0] }
material = "paint"
[materials.paint]
bsdf = "%s"
albedo = %s
"""


def test_srgb_is_the_standards():
    # The curve's ends, its knee, and 0.5, from IEC 61966-2-1 by hand.
    linear = decode_srgb([0.0, 0.04045, 0.5, 1.0])
    assert linear == pytest.approx([0.0, 0.0031308, 0.21404, 1.0], abs=1e-5)
    assert luminance([[1.0, 1.0, 1.0], [0.0, 1.0, 0.0]]) == pytest.approx([1.0, 0.7152])


def values(texture):
    """Return the values of a whole tile, what repeats in it once."""
    return texture.tile()[0]


@pytest.mark.parametrize("texture", [Noise, Spots, Text, Checker, Stripes])
def test_values_lie_between_low_and_high(texture):
    found = values(texture(low=0.2, high=0.6))
    # Single precision, and noise that never quite ends.
    assert found.min() == pytest.approx(0.2, abs=1e-3)
    assert found.max() == pytest.approx(0.6, abs=1e-3)
    swapped = values(texture(low=0.6, high=0.2))
    np.testing.assert_allclose(found + swapped, 0.8, atol=1e-6)


def test_noise_has_its_grain_no_seams_and_all_values_alike():
    grain = 0.02
    found = values(Noise(low=0.0, high=1.0, grain=grain, seed=3)).astype(np.float64)
    # Uniform to what some 1 / (4 pi grain^2) = 200 independent places of a tile leave: 5 standard
    # errors of their share below a quarter.
    assert np.mean(found < 0.25) == pytest.approx(0.25, abs=5 * np.sqrt(0.25 * 0.75 / 200))
    # White noise smoothed by s is correlated by exp(-d^2 / 4 s^2); values made uniform, by
    # 6/pi asin(that / 2).  So it is across the tile's border too.
    distance = round(2.0 * grain * 1024)
    expected = 6.0 / np.pi * np.arcsin(np.exp(-1.0) / 2.0)
    for axis in (0, 1):
        rolled = np.roll(found, distance, axis)
        assert np.corrcoef(found.ravel(), rolled.ravel())[0, 1] == pytest.approx(expected, abs=0.12)
        border = np.abs(np.diff(np.take(found, [-1, 0], axis), axis=axis)).mean()
        within = np.abs(np.diff(found, axis=axis)).mean()
        assert border == pytest.approx(within, rel=0.3)


def test_seeds_draw_the_same_again_and_others_else():
    for texture in (Noise, Spots):
        first, again, other = (values(texture(seed=s)) for s in (1, 1, 2))
        assert np.array_equal(first, again)
        assert not np.array_equal(first, other)


def test_speckle_covers_what_its_discs_do():
    """Discs at random leave exp(-count area) bare (Boolean model)."""
    ink = values(Spots(count=2000, diameter=0.03, low=0.0, high=1.0, seed=1))
    bare = np.exp(-2000 * np.pi * 0.015**2)
    # The variance of the covered share of a Boolean model: below bare (1 - bare) disc / tile.
    sigma = np.sqrt(bare * (1 - bare) * 4 * np.pi * 0.015**2)
    assert ink.mean() == pytest.approx(bare, abs=5 * sigma)


def test_stripes_and_squares_have_their_shares():
    tile, often, sharp = Stripes(count=7, share=0.3, low=0.0, high=1.0).tile()
    assert (tile.shape, often, sharp) == ((1, 1000), (7.0, 1.0), True)
    assert tile.mean() == pytest.approx(0.7)
    along_v = Stripes(count=7, share=0.3, across="v", low=0.0, high=1.0).tile()
    assert (along_v[0].shape, along_v[1]) == ((1000, 1), (1.0, 7.0))
    with pytest.raises(InputError, match="even"):
        Checker(squares=3).tile()


def test_text_fits_and_reads_from_left_to_right():
    line = {"text": "a very long line that would not fit at all", "height": 0.5, "high": 1.0}
    long = values(Text(**line, mapping="uv"))
    assert long[:, :10].min() == long[:, -10:].min() == 1.0  # some of it is left free
    # By the object's axes the middle of the text is where four tiles meet.
    assert np.array_equal(values(Text(**line)), np.roll(long, (512, 512), (0, 1)))
    word = Text(text="I.......", height=0.2, low=0.0, high=1.0, mapping="uv")
    ink = 1.0 - values(word)
    column = np.flatnonzero(ink.sum(axis=0))
    # The tall letter comes first.
    assert ink[:, column[:20]].sum() > 2.0 * ink[:, column[-20:]].sum()


def write_picture(path, seed=1):
    pixels = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    cv2.imwrite(str(path), pixels[..., ::-1])
    return pixels


def test_a_scene_takes_pictures_and_tables(tmp_path):
    pixels = write_picture(tmp_path / "a.png")
    linear = decode_srgb(pixels / 255.0) @ LUMINANCE
    table = '{ texture = "picture", path = "a.png", mapping = "box", size_mm = 30.0, scale = 0.5 }'
    (tmp_path / "s.toml").write_text(SCENE % ("rough_plastic", table))
    item = load_scene(tmp_path / "s.toml").objects[0]
    words = item.material_of("body").bsdf.mitsuba()["diffuse_reflectance"]
    np.testing.assert_allclose(words["bitmap"][..., 0], 0.5 * linear, rtol=1e-6)
    # 30 mm wide, so 22.5 mm high.
    assert np.diag(words["to_uv"]) == pytest.approx([1 / 30.0, 1 / 22.5, 1.0])
    (tmp_path / "s.toml").write_text(SCENE % ("diffuse", '{ texture = "noise", seed = 4 }'))
    assert load_scene(tmp_path / "s.toml").objects[0].material.bsdf.albedo == Noise(seed=4)


@pytest.mark.parametrize(
    ("albedo", "message"),
    [
        ("1.5", r"paint\.albedo: expected a number in \[0, 1\], a picture's file, or a table"),
        ("true", r"paint\.albedo: expected a number in \[0, 1\]"),
        ('"none.png"', r"paint\.albedo: .*none\.png"),
        ('"../a.png"', r"paint\.albedo: expected a relative path inside"),
        ('"s.toml"', r"paint\.albedo: .*s\.toml"),
        ('"a.png"', 'texture coordinates, or textures with mapping = "box"'),
        ('{ texture = "chequer" }', r"paint\.albedo\.texture: .*did you mean 'checker'"),
        ('{ texture = "noise", grains = 0.1 }', r"paint\.albedo: .*'grains'.*grain"),
        ('{ texture = "noise", grain = 0.9 }', r"paint\.albedo\.grain: expected a number in"),
        ("{ size_mm = 3.0 }", r"paint\.albedo\.texture: expected one of picture, mesh, checker"),
        ('{ texture = "mesh" }', "part body: expected a mesh that brings colours"),
    ],
)
def test_slips_are_refused_in_one_line(albedo, message, tmp_path):
    write_picture(tmp_path / "a.png")
    (tmp_path / "s.toml").write_text(SCENE % ("diffuse", albedo))
    with pytest.raises(InputError, match=message) as caught:
        load_scene(tmp_path / "s.toml")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("s.toml: ")


def test_what_a_picture_shows_counts_not_where_it_stands(tmp_path):
    keys, seeds = [], (1, 1, 2)
    for k, seed in enumerate(seeds):
        folder = tmp_path / str(k)
        folder.mkdir()
        write_picture(folder / "a.png", seed)
        table = '{ texture = "picture", path = "a.png", mapping = "box" }'
        (folder / "s.toml").write_text(SCENE % ("diffuse", table))
        keys.append(light_key(load_scene(folder / "s.toml")))
    assert keys[0] == keys[1] != keys[2]
    assert Pixels([[0.1]]) == Pixels([[0.1]]) != Pixels([[0.2]])


def test_one_mapping_for_a_material():
    plane = objects.load_artefact("plane")
    SceneObject(plane, material=Material(RoughPlastic(albedo=Noise())))
    with pytest.raises(InputError, match=re.escape('mapping = "box"')):
        SceneObject(plane, material=Material(Diffuse(albedo=Noise(mapping="uv"))))
    with pytest.raises(InputError, match="brings colours"):
        SceneObject(plane, material=Material(Diffuse(albedo=OfMesh())))


def test_a_picture_in_python_is_read_when_it_is_put_on_an_object(tmp_path):
    pixels = write_picture(tmp_path / "a.png")
    albedo = Picture(path=str(tmp_path / "a.png"), encoding="linear", mapping="box")
    item = SceneObject(objects.load_artefact("plane"), material=Material(Diffuse(albedo=albedo)))
    found = item.material_of("body").bsdf.albedo.pixels.values
    np.testing.assert_allclose(found, pixels / 255.0 @ LUMINANCE, rtol=1e-6)
