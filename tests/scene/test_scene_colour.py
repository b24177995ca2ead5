"""``[colour]``: what is refused, what is questioned, and the scene that each band is."""

from dataclasses import replace

import numpy as np
import pytest
import tomli_w
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from slbench.core.colour import BANDS, decode_srgb, luminance
from slbench.core.errors import InputError, InputWarning
from slbench.patterns import PatternSequence
from slbench.scene.colour import Colour
from slbench.scene.file import load_scene
from slbench.simulate.render.translate import shapes

PRIMARIES = ((0.9, 0.1, 0.0), (0.0, 0.8, 0.1), (0.0, 0.0, 1.0))
RESPONSE = ((0.8, 0.2, 0.0), (0.1, 0.7, 0.2), (0.0, 0.1, 0.9))


def write(folder, colour, beside=""):
    path = folder / "own.toml"
    path.write_text(f'extends = "plane"\nname = "own"\n{beside}\n[colour]\n{colour}\n')
    return path


def test_cross_talk_is_what_a_white_surface_shows():
    # Channel i sees R_ik of what band k has of primary j.
    expected = [
        [sum(RESPONSE[i][k] * PRIMARIES[k][j] for k in range(3)) for j in range(3)]
        for i in range(3)
    ]
    np.testing.assert_allclose(Colour(PRIMARIES, RESPONSE).crosstalk, expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("channels = 2", r"colour: expected one of the keys .*channels"),
        ("response = [[1, 0], [0, 1]]", r"colour\.response\[0\]: expected a list of 3"),
        ("response = [[84, 9, 7], [0, 1, 0], [0, 0, 1]]", r"\[0\]\[0\]: .*\[0, 3\], got 84"),
        ("response = [[0, 0, 0], [0, 1, 0], [0, 0, 1]]", r"red channel sees, got none"),
        ('bayer = "RGBG"', r"colour\.bayer: expected RGGB.*mean 'RGGB'"),
        ('demosaic = "nearest"', r"colour\.demosaic: expected bilinear or edge-aware"),
        ('channel = "gren"', r"colour\.channel: .*mean 'green'"),
        ("camera_scale = [1.0, 1.0]", r"colour\.camera_scale"),
        ("camera_scale = [1.0, 1.0, 1.2]", r"colour\.camera_scale\[2\]: .*\[0\.9, 1\.1\]"),
        ("ambient = [1.0, -1.0, 1.0]", r"colour\.ambient\[1\]"),
    ],
)
def test_what_is_no_colour_is_refused_in_one_line(text, said, tmp_path):
    with pytest.raises(InputError, match=said) as refused:
        load_scene(write(tmp_path, text))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("response = [[0.8, 0.3, 0.0], [0.2, 0.6, 0.3], [0.0, 0.1, 0.7]]", "transposed"),
        ("primaries = [[0.8, 0.2, 0.0], [0.3, 0.6, 0.1], [0.0, 0.3, 0.7]]", "transposed"),
        ("primaries = [[0, 0, 1], [0, 1, 0], [1, 0, 0]]", "blue, green, red"),
        ("camera_scale = [1.01, 1.0, 1.0]", "per mille"),
    ],
)
def test_what_was_probably_meant_otherwise_is_questioned(text, said, tmp_path):
    with pytest.warns(InputWarning, match=said):
        load_scene(write(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        "",
        f"primaries = {[list(row) for row in PRIMARIES]}",
        f"response = {[list(row) for row in RESPONSE]}",
        "projector_scale = [1.0005, 1.0, 0.9993]",
    ],
)
def test_what_is_usual_is_not(text, tmp_path, recwarn):
    load_scene(write(tmp_path, text))
    assert not recwarn.list


def test_colour_patterns_are_taken_apart_by_the_scenes_cross_talk(tmp_path):
    path = write(tmp_path, f"response = {[list(row) for row in RESPONSE]}")
    scene = load_scene(path).with_patterns("1,16@3+rgb")
    assert scene.sequence.channels == 3
    np.testing.assert_allclose(scene.sequence.crosstalk, RESPONSE, rtol=1e-15)
    own = ((0.9, 0.1, 0.0), (0.1, 0.9, 0.0), (0.0, 0.0, 1.0))
    stated = PatternSequence(scene.sequence.panel, scene.sequence.parts, crosstalk=own)
    assert scene.with_patterns(stated).sequence.crosstalk == own
    kept = load_scene(write(tmp_path, "unmix = false")).with_patterns("1,16@3+rgb")
    assert kept.sequence.crosstalk == ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def test_the_matrix_follows_the_scenes_colour(tmp_path):
    identity = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    path = write(tmp_path, f"response = {[list(row) for row in RESPONSE]}")
    scene = load_scene(path).with_patterns("1,16@3+rgb")
    other = replace(scene, colour=Colour(PRIMARIES))
    assert other.sequence.crosstalk == PRIMARIES
    assert replace(other, colour=scene.colour).sequence.crosstalk == scene.colour.crosstalk
    apart = replace(scene, colour=replace(scene.colour, unmix=False))
    assert apart.sequence.crosstalk == identity
    # Channels of one band do not mix.
    assert scene.in_band("red").sequence.crosstalk == identity
    shifted = scene.with_changed_patterns("1,16@4,4+rgb", None, None)
    assert replace(shifted, colour=Colour(PRIMARIES)).sequence.crosstalk == PRIMARIES


@pytest.mark.parametrize(
    "patterns",
    [
        {"sequence": "16@3"},
        {"parts": [{"kind": "fringes", "count": 16, "shifts": 3, "axis": "u"}]},
    ],
)
def test_channels_that_are_stated_not_to_mix_are_left_alone(patterns, tmp_path):
    identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    stated = patterns | {"crosstalk": identity}
    # Whole, since a scene that it extends has patterns in words.
    changed = {"patterns": stated, "colour": {"response": RESPONSE}}
    content = load_scene("plane").specification | changed
    (tmp_path / "whole.toml").write_text(tomli_w.dumps(content))
    scene = load_scene(tmp_path / "whole.toml")
    assert scene.sequence.crosstalk == identity
    assert replace(scene, colour=Colour(PRIMARIES)).sequence.crosstalk == identity
    stated = PatternSequence(
        scene.sequence.panel, scene.sequence.parts, crosstalk=identity, assumed=None
    )
    assert scene.with_patterns(stated).sequence.crosstalk == identity


def test_pictures_of_two_channels_are_refused_in_a_scene_of_three(tmp_path):
    scene = load_scene(write(tmp_path, ""))
    sequence = PatternSequence.parse("1,16@4", scene.sequence.panel)
    two = PatternSequence(sequence.panel, sequence.parts, crosstalk=((1.0, 0.1), (0.1, 1.0)))
    with pytest.raises(InputError, match=r"3 channels a picture.*got 2"):
        scene.with_patterns(two)


def test_a_band_is_a_scene_without_colour(tmp_path):
    stated = "camera_scale = [1.001, 1.0, 0.999]\nprojector_scale = [1.0, 1.0, 0.998]\n"
    beside = "[light]\nambient_w_per_m2 = 2.0"
    scene = load_scene(write(tmp_path, stated + "ambient = [0.5, 1.0, 3.0]", beside))
    for k, band in enumerate(BANDS):
        one = scene.in_band(band)
        assert one.colour is None
        assert one.light.ambient_w_per_mm2 == pytest.approx([1e-6, 2e-6, 6e-6][k])
        # A grey surface is one object: its meshes are built once.
        assert one.objects == scene.objects
        # What a point is seen at lies further from the principal point by the scale.
        point = np.array([[20.0, -30.0, 1.0]])
        pairs = (
            (scene.rig.camera, one.rig.camera, [1.001, 1.0, 0.999][k]),
            (scene.rig.projector, one.rig.projector, [1.0, 1.0, 0.998][k]),
        )
        for usual, device, scale in pairs:
            centre = np.array(usual.centre)
            # A projector's picture is larger where the same pixel lies further out.
            exponent = 1.0 if usual is scene.rig.camera else -1.0
            expected = centre + (usual.project(point)[0] - centre) * scale**exponent
            np.testing.assert_allclose(device.project(point)[0], expected, atol=1e-9)
    with pytest.raises(InputError, match="red or green or blue, got 'rde'; did you mean 'red'"):
        scene.in_band("rde")
    with pytest.raises(InputError, match=r"in colour \(\[colour\]\)"):
        load_scene("plane").in_band("red")


def looks(scene, band):
    """Return the albedo of the scene's parts in a band, by part, as Mitsuba gets it."""
    return {
        part: item.material_of(part).bsdf.albedo
        for item in scene.in_band(band).objects
        for part in item.artefact.parts
    }


def test_three_numbers_are_an_albedo(tmp_path):
    beside = '[materials.paint]\nbsdf = "rough_plastic"\nalbedo = [0.8, 0.4, 0.1]\n'
    beside = f'[[objects]]\nartefact = "plane"\nmaterial = "paint"\n{beside}'
    scene = load_scene(write(tmp_path, "", beside))
    for k, band in enumerate(BANDS):
        assert set(looks(scene, band).values()) == {(0.8, 0.4, 0.1)[k]}
    # In one band it is the luminance.
    words = scene.objects[0].material.bsdf.mitsuba()["diffuse_reflectance"]
    assert words["value"] == pytest.approx(float(luminance((0.8, 0.4, 0.1))))


@pytest.mark.parametrize("given", ["[0.8, 0.4]", "[0.8, 0.4, 1.2]", '["a", "b", "c"]'])
def test_an_albedo_of_other_than_three_numbers_is_refused(given, tmp_path):
    beside = f"[materials.paint]\nalbedo = {given}"
    with pytest.raises(InputError, match=r"materials\.paint\.albedo: .*three of them in \[0, 1\]"):
        load_scene(write(tmp_path, "", beside))


def test_meshes_and_pictures_keep_their_colours(tmp_path):
    generator = np.random.default_rng(4)
    painted, textured, plain = (trimesh.creation.box((8.0, 8.0, 2.0)) for _ in range(3))
    painted.visual.vertex_colors = generator.integers(0, 256, (8, 3), np.uint8)
    pixels = generator.integers(0, 256, (5, 7, 3), np.uint8)
    uv = textured.vertices[:, :2] / 8.0 + 0.5
    factor = [1.0, 0.8, 0.6, 1.0]
    textured.visual = TextureVisuals(
        uv, PBRMaterial("print", baseColorTexture=Image.fromarray(pixels), baseColorFactor=factor)
    )
    plain.visual = TextureVisuals(material=PBRMaterial("paint", baseColorFactor=[0.2, 0.4, 0.8, 1]))
    user = trimesh.Scene()
    for k, one in enumerate((painted, textured, plain)):
        one.apply_translation((20.0 * k, 0.0, 0.0))
        user.add_geometry(one, node_name=f"part{k}", geom_name=f"part{k}")
    user.export(tmp_path / "three.glb")
    beside = '[[objects]]\nmesh = "three.glb"\nunit = "mm"'
    scene = load_scene(write(tmp_path, "", beside))
    stated = PBRMaterial("read", baseColorFactor=factor).baseColorFactor[:3] / 255.0
    for k, band in enumerate(BANDS):
        found = looks(scene, band)
        # The factor of a file is kept as eight bits.
        assert found["part2"] == pytest.approx((0.2, 0.4, 0.8)[k], abs=0.5 / 255)
        np.testing.assert_allclose(
            found["part1"].pixels.values,
            decode_srgb(pixels[..., k] / 255.0) * stated[k],
            atol=1e-6,
        )
        every = [shape.albedo for shape in shapes(scene.in_band(band).objects)]
        (corners,) = [one for one in every if one is not None]
        expected = painted.visual.vertex_colors[:, k] / 255.0  # linear in glTF
        np.testing.assert_allclose(np.unique(corners), np.unique(expected), atol=1e-6)


def test_a_picture_keeps_its_colours(tmp_path):
    pixels = np.random.default_rng(5).integers(0, 256, (6, 4, 3), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "label.png")
    beside = '[[objects]]\nartefact = "plane"\nmaterial = "label"\n[materials.label]\n'
    scene = load_scene(
        write(
            tmp_path,
            "",
            f'{beside}albedo = {{ texture = "picture", path = "label.png", mapping = "box" }}',
        )
    )
    for k, band in enumerate(BANDS):
        (picture,) = set(looks(scene, band).values())
        expected = decode_srgb(pixels[..., k] / 255.0)
        np.testing.assert_allclose(picture.tile()[0], expected, atol=1e-6)
