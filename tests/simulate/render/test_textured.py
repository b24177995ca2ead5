"""Textured meshes: our light transport against Mitsuba's render of files that Mitsuba reads itself.

The user's file is a GLB or a PLY that slbench reads.  The same parts go to Mitsuba as files of its
own loaders, or as values: texture coordinates, luminance and vertex colours are computed there
without slbench.  The comparison is that of ``test_relight``: Welch's t-test on every pixel and on
the mean, false-alarm rate `ALPHA` each.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from helpers_scene import agreement, camera, projector, scene
from PIL import Image
from stages import trace
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from slbench import objects
from slbench.core.colour import BANDS, LUMINANCE, decode_srgb
from slbench.rig import Lens, Pose, Rig
from slbench.scene.colour import Colour
from slbench.scene.drawn import Checker, Stripes
from slbench.scene.model import SceneObject
from slbench.scene.surfaces.bsdfs import Diffuse
from slbench.scene.surfaces.materials import Material, own_materials
from slbench.simulate.render.mitsuba import mi
from slbench.simulate.render.translate import export_xml, mitsuba_dict
from slbench.simulate.stack import traced

ALPHA = 1e-4
REPEATS = 16
SAMPLES = 16
WHITE = np.ones((120, 160))
TILT = np.array([[0.96, 0.0, 0.28], [0.0, 1.0, 0.0], [-0.28, 0.0, 0.96]])


def board(x):
    """Return a plate of 34 mm x 80 mm about (x, 0), with corners of its own for every face."""
    solid = trimesh.creation.box((34.0, 80.0, 4.0))
    solid.apply_translation((x, 0.0, -2.0))
    return trimesh.Trimesh(
        solid.vertices[solid.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    )


def picture(seed):
    """Return 8 x 6 px of blocks in strong colours, each of several pixels."""
    pixels = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    return Image.fromarray(pixels).resize((64, 48), Image.Resampling.NEAREST)


@cache
def parts():
    """Return three plates: texture, vertex colours (linear), plain colour."""
    left, middle, right = board(-38.0), board(0.0), board(38.0)
    uv = left.vertices[:, :2] / [34.0, 80.0] + [1.7, 0.5]
    left.visual = TextureVisuals(
        uv, PBRMaterial("print", baseColorTexture=picture(1), baseColorFactor=[1.0, 0.8, 0.6, 1.0])
    )
    middle.visual.vertex_colors = np.random.default_rng(2).integers(20, 256, (36, 3), np.uint8)
    right.visual = TextureVisuals(
        material=PBRMaterial("paint", baseColorFactor=[0.2, 0.4, 0.8, 1.0])
    )
    return {"left": left, "middle": middle, "right": right}


@pytest.fixture(scope="module")
def glb(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "three.glb"
    user = trimesh.Scene()
    for name, one in parts().items():
        user.add_geometry(one, node_name=name, geom_name=name)
    user.export(path)
    return path


def seen(artefact, materials):
    """Return a scene of an artefact, tilted, before two lenses."""
    item = SceneObject(artefact, Pose(TILT, np.zeros(3)), materials=materials)
    down = np.diag([1.0, -1.0, -1.0])
    a, b = camera(2.0, 450.0), projector(5.6, 700.0)
    rig = Rig(
        a.posed(Pose(down, np.array([10.0, 0.0, 450.0]))),
        b.posed(Pose(down, np.array([-30.0, 0.0, 700.0]))),
    )
    return scene(rig, item)


def relit(value):
    found = [
        trace(value, ("u",), samples=SAMPLES, seed=s).relight(np.ones((1, 160)))[0]
        for s in range(REPEATS)
    ]
    return np.array(found, np.float64)


def rendered(value, shapes):
    """Return Mitsuba's renders of a scene with other shapes in the place of its own."""
    content = mitsuba_dict(value, WHITE, SAMPLES)
    content = {k: v for k, v in content.items() if not k.startswith("object")} | shapes
    loaded = mi.load_dict(content)
    images = [mi.render(loaded, spp=SAMPLES, seed=1000 + s).numpy() for s in range(REPEATS)]
    one = value.rig.camera
    return np.array(images, np.float64)[..., 0] * one.relative_illumination(one.pixel_grid())


def to_world():
    matrix = np.eye(4)
    matrix[:3, :3] = TILT
    return mi.ScalarTransform4f(matrix.tolist())


def diffuse(reflectance):
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def theirs(folder, srgb_vertices=False, weights=LUMINANCE):
    """Return the three plates as files that Mitsuba reads by itself.

    Of colours the sum with `weights` counts.
    """
    left, middle, right = parts().values()
    lines = [f"v {x} {y} {z}" for x, y, z in left.vertices]
    lines += [f"vt {u} {v}" for u, v in left.visual.uv]
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in left.faces + 1]
    (folder / "left.obj").write_text("\n".join(lines))
    # Mitsuba takes the luminance of a picture in colour; the factor is put into the picture here.
    # Other sums are put there as a grey picture.
    pixels = np.asarray(left.visual.material.baseColorTexture)
    factor = left.visual.material.baseColorFactor[:3] / 255.0
    linear = (decode_srgb(pixels / 255.0) * factor).astype(np.float32)
    if weights is not LUMINANCE:
        linear = (linear @ np.float32(weights))[..., np.newaxis]
    right.export(folder / "right.ply", vertex_normal=False)
    colours = middle.visual.vertex_colors[:, :3] / 255.0
    values = decode_srgb(colours) if srgb_vertices else colours
    attribute = {"type": "mesh_attribute", "name": "vertex_c"}
    mesh = mi.Mesh("middle", 36, 12, props=_props(diffuse(attribute)))
    mesh.add_attribute("vertex_c", 1, (values @ np.array(weights)).astype(np.float32))
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float((middle.vertices @ TILT.T).astype(np.float32).ravel())
    params["faces"] = mi.UInt32(middle.faces.astype(np.uint32).ravel())
    params.update()
    bitmap = mi.Bitmap(linear)
    texture = {"type": "bitmap", "bitmap": bitmap, "raw": False, "filter_type": "bilinear"}
    paint = float(right.visual.material.baseColorFactor[:3] / 255.0 @ np.array(weights))
    more = {"face_normals": True, "to_world": to_world()}
    return {
        "left": {
            "type": "obj",
            "filename": str(folder / "left.obj"),
            "bsdf": diffuse(texture),
            **more,
        },
        "middle": mesh,
        "right": {
            "type": "ply",
            "filename": str(folder / "right.ply"),
            "bsdf": diffuse({"type": "uniform", "value": paint}),
            **more,
        },
    }


def _props(bsdf):
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    return props


def test_a_glb_of_three_parts_is_rendered_as_mitsuba_does(glb, tmp_path):
    artefact = objects.build_artefact("mesh", {"path": str(glb), "unit": "mm"})
    assert set(artefact.parts) == {"left", "middle", "right"}
    value = seen(artefact, own_materials(artefact))
    ours, other = relit(value), rendered(value, theirs(tmp_path))
    assert np.mean(ours.mean(axis=0) > 0.1 * ours.mean()) > 0.4  # most of the field is lit
    assert agreement(other, ours).p > ALPHA
    # The test sees small errors: of the level, of one part, of the picture's place.
    assert agreement(other, 1.02 * ours).p < 1e-9
    grey = relit(seen(artefact, own_materials(artefact) | {"left": Material(Diffuse(albedo=0.25))}))
    assert agreement(other, grey).p < 1e-9
    flipped = replace(artefact, mesh=replace(artefact.mesh, uv=artefact.mesh.uv * [1.0, -1.0]))
    assert agreement(other, relit(seen(flipped, own_materials(flipped)))).p < 1e-9


@pytest.mark.parametrize("k", range(3), ids=BANDS)
def test_bands_of_a_glb_in_colour_are_rendered_as_mitsuba_does(k, glb, tmp_path):
    artefact = objects.build_artefact("mesh", {"path": str(glb), "unit": "mm"})
    value = replace(seen(artefact, own_materials(artefact)), colour=Colour(), samples=SAMPLES)
    panels = np.ones((3, 1, 160))
    ours = np.array(
        [traced(value, ("u",), seed=s)[0].seen(panels, "u", (k,))[0, 0] for s in range(REPEATS)],
        np.float64,
    )
    plain = value.in_band(BANDS[k])
    other = rendered(plain, theirs(tmp_path, weights=np.eye(3)[k]))
    assert agreement(other, ours).p > ALPHA
    # It sees small errors of the level, and another channel.
    assert agreement(other, 1.02 * ours).p < 1e-9
    wrong = rendered(plain, theirs(tmp_path, weights=np.eye(3)[k - 1]))
    assert agreement(wrong, ours).p < 1e-9


def test_vertex_colours_of_a_ply_are_rendered_as_mitsuba_does(tmp_path):
    path = tmp_path / "middle.ply"
    parts()["middle"].export(path)
    artefact = objects.build_artefact("mesh", {"path": str(path), "unit": "mm"})
    value = seen(artefact, own_materials(artefact))
    # Bytes of a PLY are sRGB.
    expected = {"middle": theirs(tmp_path, srgb_vertices=True)["middle"]}
    ours, other = relit(value), rendered(value, expected)
    assert agreement(other, ours).p > ALPHA
    assert agreement(other, 1.02 * ours).p < 1e-9
    linear = {"middle": theirs(tmp_path)["middle"]}
    assert agreement(rendered(value, linear), ours).p < 1e-9


def test_textures_and_vertex_colours_are_exported(glb, tmp_path):
    """The XML, its pictures and its PLY render as the dictionary does (Welch's test, `ALPHA`)."""
    artefact = objects.build_artefact("mesh", {"path": str(glb), "unit": "mm"})
    materials = own_materials(artefact) | {"right": Material(Diffuse(albedo=Checker()))}
    value = seen(artefact, materials)
    plain = replace(value.rig.projector, lens=Lens(28.0, natural_vignetting=False))
    value = replace(value, rig=value.rig.having(projector=plain))
    written = export_xml(value, tmp_path / "scene.xml", WHITE)
    assert sum(one.suffix == ".exr" for one in written) == 3  # the panel, print and checker
    assert sorted(written) == sorted(tmp_path.iterdir())
    loaded = mi.load_file(str(tmp_path / "scene.xml")), mi.load_dict(mitsuba_dict(value, WHITE))
    first, second = (
        np.array([mi.render(s, spp=16, seed=50 * k + i).numpy()[..., 0] for i in range(16)])
        for k, s in enumerate(loaded)
    )
    assert agreement(first, second).p > ALPHA
    assert agreement(first, 1.02 * second).p < 1e-6


def plane(size, texture):
    artefact = objects.build_artefact("plane", {"size_mm": size, "thickness_mm": 1.0})
    return SceneObject(artefact, material=Material(Diffuse(albedo=texture)))


def test_squares_stand_where_their_size_says():
    """A checker of 20 mm squares, seen from straight above: each pixel has its square's albedo."""
    item = plane((160.0, 120.0), Checker(size_mm=40.0, low=0.2, high=0.8))
    down = np.diag([1.0, -1.0, -1.0])
    pose = Pose(down, np.array([0.0, 0.0, 450.0]))
    above = Pose(down, np.array([0.0, 0.0, 900.0]))  # lights all that the camera sees
    rig = Rig(camera(size=(160, 120)).posed(pose), projector().posed(above))
    textured, even = (
        trace(scene(rig, one), ("u",), samples=SAMPLES).white()
        for one in (item, plane((160.0, 120.0), 1.0))
    )
    v, u = np.mgrid[0:120, 0:160]
    origin, direction = rig.camera.unproject(np.stack([u, v], axis=-1).astype(float))
    x, y = np.moveaxis(
        (origin - direction * (origin[..., 2:] / direction[..., 2:]))[..., :2], -1, 0
    )
    inside = (np.abs(x) < 64.0) & (np.abs(y) < 48.0)
    # A pixel is 0.83 mm wide: half a millimetre off an edge it may see both sides.
    clear = (np.abs((x + 10) % 20 - 10) > 0.9) & (np.abs((y + 10) % 20 - 10) > 0.9) & inside
    assert clear.sum() > 8000
    # The tile begins at the origin, its first square low, x to the right and y up.
    low = (np.floor(x / 20.0) + np.floor(y / 20.0)) % 2 == 1
    expected = np.where(low, 0.2, 0.8)
    ratio = textured[clear] / even[clear]
    np.testing.assert_allclose(ratio, expected[clear], rtol=1e-3)  # weights of 15 bits


def test_a_texture_edge_biases_phase_as_albedo_weighs_it():
    """A pixel across an albedo edge has the mean phase of its sides, weighed by their albedos.

    A pixel sees the plane over a width w.  Phase runs along it at k a millimetre.  A share s of it
    on the left has albedo a, the rest b: its phasor is the integral of ``albedo(x) exp(i k x)``.
    Slowly running fringes, seen at right angles, leave nothing else.
    """
    low, high = 0.1, 0.8
    down = np.diag([1.0, -1.0, -1.0])
    # Panel pixels of 0.15 mm on the plane: their stairs are nothing beside a pixel of 3.3 mm.
    a, b = camera(size=(40, 30)), projector(size=(1280, 960), vignetting=False)
    rig = Rig(
        a.posed(Pose(down, np.array([0.0, 0.0, 450.0]))),
        b.posed(Pose(down, np.array([0.0, 0.0, 800.0]))),
    )
    # The edge of the stripes at x = 0 and at every 50 mm, moved by a fraction of a pixel with
    # the plate; bottom and sides are not seen.
    item = plane((180.0, 140.0), Stripes(size_mm=100.0, low=low, high=high))
    fringes = 8
    u = np.arange(1280)
    shifts = 2.0 * np.pi * np.arange(3) / 3.0
    frames = 0.5 + 0.5 * np.cos(2.0 * np.pi * fringes * (u + 0.5) / 1280 - shifts[:, None])

    def phase(one, x):
        moved = replace(one, pose=Pose(np.eye(3), np.array([x, 0.0, 0.0])))
        light = trace(scene(rig, moved), ("u",), samples=256, seed=1)
        images = light.relight(frames.astype(np.float32)).astype(np.float64)
        phasor = np.einsum("k,kvu->vu", np.exp(1j * shifts), images)
        return np.angle(phasor[15])

    width = 450.0 * a.pitch_mm[0] / 16.0  # of a pixel, on the plane
    per_mm = 2.0 * np.pi * fringes / (160 * 0.0432 * 800.0 / 28.0)
    even = plane((180.0, 140.0), 0.5)
    for share in (0.25, 0.5, 0.8):
        # Pixel 20 sees x from 0 to w: the edge at `share` of it.
        edge = share * width
        bias = np.angle(np.exp(1j * (phase(item, edge) - phase(even, edge))))[20]
        left, right = np.array([0.0, edge]), np.array([edge, width])
        phasor = sum(
            albedo * np.diff(np.exp(1j * per_mm * side))[0] / (1j * per_mm)
            for albedo, side in ((high, left), (low, right))
        )
        plain = np.angle(np.diff(np.exp(1j * per_mm * np.array([0.0, width])))[0] / (1j * per_mm))
        expected = np.angle(phasor) - plain
        assert abs(expected) > 0.05  # or it would be no test
        # 256 samples are strata of 1/16 of a pixel along u at the least, jittered: an edge is found
        # to some 1/16 / sqrt(16 * 12) of it, 0.005, and 5 of these times the phase of a pixel, 0.4.
        assert bias == pytest.approx(expected, abs=0.01)
