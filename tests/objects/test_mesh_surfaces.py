"""What a mesh file brings beside triangles: parts, colours, pictures, normals; the rest is said."""

import json
import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from slbench import objects
from slbench.core.colour import LUMINANCE, decode_srgb
from slbench.core.errors import InputError
from slbench.objects.mesh.shading import smooth_normals


def read(path, **more):
    return objects.build_artefact("mesh", {"path": str(path), "unit": "mm", **more})


def quietly(path, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read(path, **more)


def box(x=0.0):
    solid = trimesh.creation.box((10.0, 10.0, 10.0))
    solid.apply_translation((x, 0.0, 0.0))
    return solid


@pytest.fixture
def pixels():
    return np.random.default_rng(1).integers(0, 256, (4, 6, 3), dtype=np.uint8)


def textured(pixels, factor=None):
    solid, uv = box(), np.random.default_rng(2).random((8, 2))
    material = PBRMaterial(baseColorTexture=Image.fromarray(pixels), baseColorFactor=factor)
    solid.visual = TextureVisuals(uv, material)
    return solid, uv


def uv_by_place(artefact, vertices, uv):
    """Return the largest error of the texture coordinates at all corners."""
    corners = artefact.mesh.vertices[artefact.mesh.faces]
    nearest = np.linalg.norm(corners[..., None, :] - vertices, axis=-1).argmin(axis=-1)
    return np.abs(artefact.mesh.uv - uv[nearest]).max()


@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_a_picture_becomes_an_albedo(suffix, pixels, tmp_path):
    solid, uv = textured(pixels, [1.0, 0.6, 0.2, 1.0])
    if suffix == "glb":
        solid.export(tmp_path / "a.glb")
        part = quietly(tmp_path / "a.glb")
    else:
        text, beside = trimesh.exchange.obj.export_obj(solid, return_texture=True)
        (tmp_path / "a.obj").write_text(text)
        for name, content in beside.items():
            (tmp_path / name).write_bytes(content)
        with pytest.warns(UserWarning, match=r"a.obj: not used: ks, ns$"):
            part = read(tmp_path / "a.obj")
    assert list(part.parts) == ["body"]
    # Factors are kept in 8 bits by the writer, and pictures are lossless.
    expected = decode_srgb(pixels / 255.0) * np.round([255.0, 153.0, 51.0]) / 255.0 @ LUMINANCE
    np.testing.assert_allclose(part.surfaces["body"].picture.values, expected, atol=1e-6)
    assert uv_by_place(part, solid.vertices, uv) < 1e-6
    assert part.mesh.is_watertight


@pytest.mark.parametrize(("suffix", "linear"), [("glb", True), ("ply", False), ("obj", False)])
def test_vertex_colours(suffix, linear, tmp_path):
    solid = box()
    colours = np.random.default_rng(3).integers(0, 256, (8, 3), dtype=np.uint8)
    solid.visual.vertex_colors = colours
    solid.export(tmp_path / f"a.{suffix}")
    part = quietly(tmp_path / f"a.{suffix}")
    values = colours / 255.0 if linear else decode_srgb(colours / 255.0)
    corners = part.mesh.vertices[part.mesh.faces]
    nearest = np.linalg.norm(corners[..., None, :] - solid.vertices, axis=-1).argmin(axis=-1)
    np.testing.assert_allclose(part.mesh.albedo, (values @ LUMINANCE)[nearest], atol=1e-9)
    assert part.surfaces["body"].corners
    assert part.mesh.is_watertight


def test_parts_keep_their_names_places_and_looks(pixels, tmp_path):
    wood, _ = textured(pixels)
    paint = box(20.0)
    paint.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=[0.2, 0.4, 0.6, 1.0]))
    user = trimesh.Scene()
    user.add_geometry(wood, node_name="wood", geom_name="g1")
    user.add_geometry(paint, node_name="paint", geom_name="g2")
    user.add_geometry(box(), node_name="bare", geom_name="g3")
    mirrored = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirrored[0, 3] = -40.0
    user.graph.update("again", matrix=mirrored, geometry="g2")
    user.graph.update("bare", matrix=trimesh.transformations.translation_matrix([0, 30, 0]))
    user.export(tmp_path / "a.glb")
    part = quietly(tmp_path / "a.glb")
    assert set(part.parts) == {"wood", "paint", "bare", "again"}
    middles = {
        k: part.mesh.vertices[part.mesh.faces[f]].mean(axis=(0, 1)) for k, f in part.parts.items()
    }
    assert middles["paint"] == pytest.approx([20, 0, 0], abs=1e-5)
    assert middles["bare"] == pytest.approx([0, 30, 0], abs=1e-5)
    assert middles["again"] == pytest.approx([-60, 0, 0], abs=1e-5)
    # Mirroring turns faces inside out, unless they are turned again.
    assert part.mesh.is_watertight
    assert part.mesh.volume == pytest.approx(4000.0, rel=1e-5)
    assert set(part.surfaces) == {"wood", "paint", "again"}
    expected = np.round(255 * np.array([0.2, 0.4, 0.6])) / 255 @ LUMINANCE
    assert part.surfaces["again"].albedo == pytest.approx(expected)
    assert np.isnan(part.mesh.uv[part.parts["paint"]]).all()


def test_objects_of_an_obj_are_parts(tmp_path):
    lines = []
    for k, name in enumerate(("left", "right")):
        solid = box(20.0 * k)
        lines += [f"o {name}", *(f"v {x} {y} {z}" for x, y, z in solid.vertices)]
        lines += [f"f {a} {b} {c}" for a, b, c in solid.faces + 8 * k + 1]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    part = quietly(tmp_path / "a.obj")
    assert set(part.parts) == {"left", "right"}
    assert all(len(faces) == 12 for faces in part.parts.values())


def test_parts_that_touch_are_watertight_each(tmp_path):
    """Two boxes that share an edge: merged, four faces would meet there."""
    user = trimesh.Scene()
    other = box()
    other.apply_translation((10.0, 10.0, 0.0))
    user.add_geometry(box(), node_name="a", geom_name="a")
    user.add_geometry(other, node_name="b", geom_name="b")
    user.export(tmp_path / "a.glb")
    assert quietly(tmp_path / "a.glb").mesh.is_watertight


def shaken(solid, steps, rng):
    """Return a solid's triangles, each coordinate off by some steps of single precision."""
    triangles = solid.triangles.astype(np.float32)
    far = np.float32(np.abs(triangles).max())
    step = np.spacing(far)
    return triangles + rng.integers(-steps, steps + 1, triangles.shape).astype(np.float32) * step


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_vertices_off_by_the_last_bit_are_one(scale, tmp_path):
    solid = trimesh.creation.icosphere(subdivisions=3, radius=12.5 * scale)
    triangles = shaken(solid, 1, np.random.default_rng(1))
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    trimesh.Trimesh(triangles.reshape(-1, 3), faces, process=False).export(tmp_path / "a.stl")
    part = quietly(tmp_path / "a.stl")
    assert part.mesh.is_watertight
    assert len(part.mesh.vertices) == len(solid.vertices)
    assert part.mesh.volume == pytest.approx(solid.volume, rel=1e-6)


def test_a_gap_is_not_merged_away(tmp_path):
    """A box whose lid lies 1e-4 of its size above: nothing that rounding makes."""
    solid = box()
    triangles = solid.triangles.copy()
    lid = np.isclose(triangles[..., 2], 5.0).all(axis=1)
    triangles[lid, :, 2] += 1e-3
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    trimesh.Trimesh(triangles.reshape(-1, 3), faces, process=False).export(tmp_path / "a.stl")
    with pytest.warns(UserWarning, match="watertight") as caught:
        part = read(tmp_path / "a.stl")
    assert len(caught) == 1
    assert part.mesh.bounds[1, 2] == pytest.approx(5.001)


def test_what_is_not_used_is_said_in_one_line(pixels, tmp_path):
    solid, _ = textured(pixels)
    solid.visual.material.emissiveFactor = [0.1, 0.1, 0.1]
    solid.visual.material.alphaMode = "BLEND"
    other, _ = textured(pixels[::-1])
    other.visual.material.emissiveFactor = [0.2, 0.2, 0.2]
    user = trimesh.Scene()
    user.add_geometry(solid)
    user.add_geometry(other, transform=trimesh.transformations.translation_matrix([20, 0, 0]))
    user.export(tmp_path / "a.glb")
    with pytest.warns(UserWarning, match="not used") as caught:
        read(tmp_path / "a.glb")
    lines = [str(w.message) for w in caught]
    assert lines == [f"{tmp_path / 'a.glb'}: not used: emissiveFactor, transparency"]


@pytest.mark.parametrize("name", ["none.mtl", "../a.mtl"])
def test_materials_beside_an_obj_and_nowhere_else(name, tmp_path):
    folder = tmp_path / "inner"
    folder.mkdir()
    (tmp_path / "a.mtl").write_text("newmtl paint\nKd 0.5 0.5 0.5\n")
    rows = [f"v {x} {y} {z}" for x, y, z in box().vertices]
    rows += [f"mtllib {name}", "usemtl paint", *(f"f {a} {b} {c}" for a, b, c in box().faces + 1)]
    (folder / "a.obj").write_text("\n".join(rows))
    with pytest.warns(UserWarning, match=rf"not used: {name} \(no such file beside it\)"):
        part = read(folder / "a.obj")
    assert not part.surfaces
    (folder / "b.mtl").write_text("newmtl paint\nKd 0.5 0.5 0.5\n")
    (folder / "a.obj").write_text("\n".join(rows).replace(name, "b.mtl"))
    assert quietly(folder / "a.obj").surfaces["body"].albedo == pytest.approx(0.5)


def test_a_picture_out_of_proportion_is_refused(tmp_path):
    """A texture of 9000 x 9000 px of nothing in a file of 80 kB unpacks to 324 MB."""
    Image.new("L", (9000, 9000)).save(tmp_path / "big.png", compress_level=9)
    rows = [f"v {x} {y} {z}" for x, y, z in box().vertices] + ["vt 0 0"]
    rows += ["mtllib a.mtl", "usemtl p", *(f"f {a}/1 {b}/1 {c}/1" for a, b, c in box().faces + 1)]
    (tmp_path / "a.obj").write_text("\n".join(rows))
    (tmp_path / "a.mtl").write_text("newmtl p\nmap_Kd big.png\n")
    with pytest.raises(InputError, match=r"a\.obj: expected at most"):
        read(tmp_path / "a.obj")


def test_a_picture_that_cannot_be_read_is_said(tmp_path):
    rows = [f"v {x} {y} {z}" for x, y, z in box().vertices] + ["vt 0 0"]
    rows += ["mtllib a.mtl", "usemtl p", *(f"f {a}/1 {b}/1 {c}/1" for a, b, c in box().faces + 1)]
    (tmp_path / "a.obj").write_text("\n".join(rows))
    (tmp_path / "a.mtl").write_text("newmtl p\nKd 0.5 0.5 0.5\nmap_Kd big.png\n")
    (tmp_path / "big.png").write_bytes(b"no picture")
    with pytest.warns(UserWarning, match=r"not used: big.png \(no picture that can be read\)$"):
        assert read(tmp_path / "a.obj").surfaces["body"].albedo == pytest.approx(0.5)


class TestNormals:
    """What light is shaded by."""

    def test_the_files_own(self, tmp_path):
        ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
        exact = ball.vertices / 10.0
        ball.vertex_normals = exact
        ball.export(tmp_path / "a.glb", include_normals=True)
        part = quietly(tmp_path / "a.glb")
        expected = part.mesh.vertices[part.mesh.faces] / 10.0
        np.testing.assert_allclose(part.mesh.normals, expected, atol=1e-6)
        assert quietly(tmp_path / "a.glb", normals="facets").mesh.normals is None

    def test_smooth_ones_are_trimeshs(self):
        """On a surface without edges they are trimesh's, which weighs by angles too."""
        ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
        ball.apply_scale([1.0, 1.5, 2.0])
        mesh = objects.Mesh(ball.vertices, ball.faces)
        expected = ball.vertex_normals[ball.faces]
        np.testing.assert_allclose(smooth_normals(mesh), expected, atol=1e-9)
        # And nothing that facets have already, which lean by up to 1.4 degrees and more.
        facets = np.repeat(ball.face_normals[:, None], 3, axis=1)
        assert np.abs(facets - expected).max() > 0.02

    def test_edges_stay(self):
        solid = box().subdivide()
        mesh = objects.Mesh(solid.vertices, solid.faces)
        expected = np.repeat(solid.face_normals[:, None], 3, axis=1)
        np.testing.assert_allclose(smooth_normals(mesh), expected, atol=1e-12)

    def test_round_edges_are_questioned(self, tmp_path):
        solid = box()
        solid.export(tmp_path / "a.ply", vertex_normal=True)
        with pytest.warns(UserWarning, match='up to 5.*normals = "facets"'):
            read(tmp_path / "a.ply")
        smooth = quietly(tmp_path / "a.ply", normals="smooth")
        assert np.abs(np.abs(smooth.mesh.normals).max(axis=-1) - 1.0).max() < 1e-9

    def test_turn_with_the_object(self, tmp_path):
        ball = trimesh.creation.icosphere(subdivisions=2)
        mesh = objects.Mesh(ball.vertices, ball.faces, normals=ball.vertices[ball.faces])
        turn = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0])[:3, :3]
        moved = mesh.transformed(turn, [1.0, 2.0, 3.0])
        expected = moved.vertices[moved.faces] - [1.0, 2.0, 3.0]
        np.testing.assert_allclose(moved.normals, expected, atol=1e-9)


def test_shapes_of_corner_values_are_checked():
    with pytest.raises(InputError, match=r"mesh: uv: expected an array of shape \(1, 3, 2\)"):
        objects.Mesh(np.eye(3), [[0, 1, 2]], uv=np.zeros((3, 2)))


def test_extensions_and_animations_are_named(tmp_path):
    content = trimesh.exchange.gltf.export_gltf(trimesh.Scene(box()))
    for name, data in content.items():
        (tmp_path / name).write_bytes(data)
    tables = json.loads((tmp_path / "model.gltf").read_text())
    tables["extensionsUsed"] = ["KHR_materials_volume", "KHR_draco_mesh_compression"]
    tables["animations"] = [{"channels": [], "samplers": []}]
    (tmp_path / "model.gltf").write_text(json.dumps(tables))
    with pytest.warns(UserWarning, match=r"not used: KHR_materials_volume, animations$"):
        read(tmp_path / "model.gltf")


def test_objects_of_a_3mf_are_parts(tmp_path):
    pytest.importorskip("lxml", reason="3MF is read where lxml is installed")
    user = trimesh.Scene()
    user.add_geometry(box(), node_name="left", geom_name="left")
    user.add_geometry(box(20.0), node_name="right", geom_name="right")
    user.export(tmp_path / "a.3mf")
    part = quietly(tmp_path / "a.3mf")
    assert len(part.parts) == 2
    assert part.mesh.is_watertight
    assert part.mesh.bounds == pytest.approx(np.array([[-5, -5, -5], [25, 5, 5]]), abs=1e-5)
