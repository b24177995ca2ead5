"""Rigs as OpenCV YAML: OpenCV loads them, OpenCV's numbers mean the same, bad files say why."""

from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slbench.core.errors import InputError, InputWarning
from slbench.core.io import read_opencv_yaml
from slbench.rig import Camera, DesignVariables, Lens, Projector, Rig
from slbench.rig.opencv import read_rig, write_rig

DESIGN = DesignVariables(756.3, -412.5, -100.0, 337.5, np.deg2rad(-18.0), np.deg2rad(10.88))
ERRORS = (-0.25, 0.12, 0.002, -0.003, 0.02)
CAMERA = Camera(
    640, 480, (0.0074, 0.0081), Lens(16.0, 2.0, 453.9), (311.3, 251.9), ERRORS, (0.08, -0.05)
)
PROJECTOR = Projector(
    1024,
    768,
    (0.0108, 0.0108),
    Lens(28.0, 5.6, 809.8, natural_vignetting=False),
    distortion=ERRORS,
    flux_w=2.5,
    bit_depth=10,
    gamma=2.2,
    body_mm=(200.0, 55.0, 115.0),
)
RIG = Rig.from_design(DESIGN, CAMERA, PROJECTOR, (50.0, 40.0, 20.0))
TELECENTRIC = Rig(
    replace(RIG.camera, lens=Lens.telecentric(0.05, 0.02, 450.0)),
    replace(RIG.projector, lens=Lens(28.0), bit_depth=None),
)


def assert_same(first, second):
    for name in ("camera", "projector"):
        a, b = getattr(first, name), getattr(second, name)
        assert type(a) is type(b)
        for field in fields(a):
            one, two = getattr(a, field.name), getattr(b, field.name)
            if field.name == "lens":
                assert (one.kind, one.natural_vignetting) == (two.kind, two.natural_vignetting)
                names = ("focal_length_mm", "aperture_radius_mm", "focus_distance_mm")
                one, two = ([getattr(x, n) for n in names] for x in (one, two))
            if field.name == "pose":
                np.testing.assert_allclose(one.rotation, two.rotation, rtol=0.0, atol=1e-12)
                one, two = one.position, two.position
            if one is None or isinstance(one, int):
                assert one == two
            else:
                np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9, err_msg=field.name)
    assert first.volume_mm == pytest.approx(second.volume_mm)


@pytest.mark.parametrize("rig", [RIG, TELECENTRIC], ids=["perspective", "telecentric"])
def test_round_trip(rig, tmp_path):
    write_rig(tmp_path / "rig.yml", rig)
    assert_same(read_rig(tmp_path / "rig.yml"), rig)


@settings(max_examples=30, deadline=None)
@given(
    wavelengths=st.tuples(*[st.floats(0.0, 2000.0)] * 2),
    blurs=st.tuples(*[st.floats(0.0, 20.0)] * 2),
    fill=st.floats(0.05, 1.0),
)
def test_what_lenses_spread_comes_back_to_the_last_bit(wavelengths, blurs, fill):
    lenses = [Lens(16.0, 2.0, 450.0, wavelength_nm=nm) for nm in wavelengths]
    rig = Rig(
        Camera(64, 48, (0.01, 0.01), lenses[0], blur_px=blurs[0], fill_factor=fill),
        Projector(64, 48, (0.01, 0.01), lenses[1], blur_px=blurs[1]),
    )
    with TemporaryDirectory() as folder:
        write_rig(Path(folder) / "rig.yaml", rig)
        back = read_rig(Path(folder) / "rig.yaml")
    for one, two in ((rig.camera, back.camera), (rig.projector, back.projector)):
        assert one.lens.wavelength_nm == two.lens.wavelength_nm
        assert one.spread == two.spread
    assert back.camera.fill_factor == fill
    # What is not nothing is said.
    assert ("blur" in repr(back.camera)) == (blurs[0] > 0.0)
    assert ("nm in focus" in repr(back.projector)) == (wavelengths[1] > 0.0)


def test_opencv_alone_projects_to_the_same_pixels(tmp_path):
    """Only cv2 from here: what an OpenCV user does with the file."""
    write_rig(tmp_path / "rig.yaml", RIG)
    file = cv2.FileStorage(str(tmp_path / "rig.yaml"), cv2.FILE_STORAGE_READ)
    names = ("K_camera", "dist_camera", "K_projector", "dist_projector", "R", "T")
    k_c, d_c, k_p, d_p, r, t = (file.getNode(name).mat() for name in names)
    r_world, t_world = file.getNode("R_world").mat(), file.getNode("T_world").mat()
    sizes = [file.getNode(f"size_{name}").mat().ravel() for name in ("camera", "projector")]
    file.release()
    assert [size.tolist() for size in sizes] == [[640.0, 480.0], [1024.0, 768.0]]
    assert d_c.size == 14
    assert d_p.size == 5
    world = np.random.default_rng(0).uniform(-25.0, 25.0, (200, 3))
    # World to camera, then to the projector: the convention of cv2.stereoCalibrate.
    rotation, _ = cv2.Rodrigues(r_world)
    in_camera, _ = cv2.projectPoints(world, rotation, t_world, k_c, d_c)
    rotation, offset, *_ = cv2.composeRT(rotation, t_world, cv2.Rodrigues(r)[0], t)
    in_projector, _ = cv2.projectPoints(world, rotation, offset, k_p, d_p)
    # Rotation vectors there and back in double precision.
    np.testing.assert_allclose(in_camera[:, 0], RIG.camera.project(world), atol=1e-8)
    np.testing.assert_allclose(in_projector[:, 0], RIG.projector.project(world), atol=1e-8)
    assert RIG.camera.contains(in_camera[:, 0]).mean() > 0.9


def plain():
    """What a calibration with OpenCV gives, without any key of ours."""
    return {
        "K_camera": np.array([[2000.0, 0.0, 310.0], [0.0, 2010.0, 250.0], [0.0, 0.0, 1.0]]),
        "dist_camera": np.array([[-0.1, 0.02, 0.001, 0.0, 0.0]]),
        "size_camera": np.array([640.0, 480.0]),
        "K_projector": np.array([[2600.0, 0.0, 500.0], [0.0, 2600.0, 400.0], [0.0, 0.0, 1.0]]),
        "dist_projector": np.zeros((1, 5)),
        "size_projector": np.array([1024.0, 768.0]),
        "R": cv2.Rodrigues(np.array([0.05, -0.4, 0.02]))[0],
        "T": np.array([[120.0], [5.0], [30.0]]),
    }


def written(path, values):
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value = value.reshape(len(value), -1)  # an OpenCV matrix has two axes
        if value is not None:
            file.write(name, value)
    file.release()
    return path


class TestPlainCalibration:
    def test_loads(self, tmp_path):
        values = plain()
        rig = read_rig(written(tmp_path / "stereo.yml", values))
        # The world is the camera's frame.
        np.testing.assert_array_equal(rig.camera.pose.rotation, np.eye(3))
        np.testing.assert_array_equal(rig.camera.pose.position, np.zeros(3))
        points = np.random.default_rng(1).uniform((-40, -30, 300), (40, 30, 400), (100, 3))
        for device, name, r, t in (
            (rig.camera, "camera", np.eye(3), np.zeros(3)),
            (rig.projector, "projector", values["R"], values["T"]),
        ):
            theirs, _ = cv2.projectPoints(
                points, cv2.Rodrigues(r)[0], t, values[f"K_{name}"], values[f"dist_{name}"]
            )
            np.testing.assert_allclose(device.project(points), theirs[:, 0], atol=1e-8)
            np.testing.assert_allclose(device.matrix, values[f"K_{name}"], rtol=1e-12)
        assert (rig.camera.width, rig.camera.height) == (640, 480)
        assert rig.camera.lens.aperture_radius_mm == 0.0
        assert rig.camera.lens.focus_distance_mm == np.inf
        assert rig.projector.bit_depth == 8

    def test_further_entries_are_left_alone(self, tmp_path):
        path = written(tmp_path / "stereo.yml", plain())
        alone = read_rig(path)
        with path.open("a") as stream:
            stream.write('images: [ "a.png", "b.png" ]\nboard: { columns: 9, rows: 6 }\n')
        rig = read_rig(path)
        np.testing.assert_array_equal(rig.projector.matrix, alone.projector.matrix)
        np.testing.assert_array_equal(rig.projector.pose.position, alone.projector.pose.position)

    @pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
    def test_any_number_of_coefficients(self, tmp_path, count):
        coefficients = np.zeros(count)
        coefficients[:4] = [-0.1, 0.02, 0.001, 0.002]
        if count == 14:
            coefficients[12:] = [0.03, -0.02]
        values = plain() | {"dist_camera": coefficients[:, None]}
        camera = read_rig(written(tmp_path / "rig.yml", values)).camera
        assert camera.distortion == (-0.1, 0.02, 0.001, 0.002, 0.0)
        assert camera.tilt_rad == ((0.03, -0.02) if count == 14 else (0.0, 0.0))

    @pytest.mark.parametrize(("count", "written_as"), [(5, 5), (6, 8), (8, 8), (9, 12), (14, 14)])
    def test_as_many_coefficients_are_written_as_it_takes(self, tmp_path, count, written_as):
        coefficients = np.zeros(14)
        coefficients[:count] = 0.01 * np.arange(1, count + 1)
        read = read_rig(written(tmp_path / "rig.yml", plain() | {"dist_camera": coefficients}))
        write_rig(tmp_path / "again.yml", read)
        file = cv2.FileStorage(str(tmp_path / "again.yml"), cv2.FILE_STORAGE_READ)
        theirs = file.getNode("dist_camera").mat().ravel()
        file.release()
        np.testing.assert_array_equal(theirs, coefficients[:written_as])
        assert read_rig(tmp_path / "again.yml").camera.distortion == read.camera.distortion
        world = np.random.default_rng(0).uniform((-25, -25, 375), (25, 25, 425), (200, 3))
        expected = cv2.projectPoints(
            world, np.zeros(3), np.zeros(3), read.camera.matrix, coefficients
        )[0][:, 0]
        np.testing.assert_allclose(read.camera.project(world), expected, atol=1e-9)

    def test_distortion_may_be_missing(self, tmp_path):
        values = plain() | {"dist_camera": None}
        camera = read_rig(written(tmp_path / "rig.yml", values)).camera
        assert camera.distortion == (0.0,) * 5


NAN = np.full((3, 3), np.nan)
SKEWED = np.array([[2000.0, 3.0, 310.0], [0.0, 2000.0, 250.0], [0.0, 0.0, 1.0]])
TRANSPOSED = np.array([[2000.0, 0.0, 0.0], [0.0, 2000.0, 0.0], [310.0, 250.0, 1.0]])

BAD = [
    *((name, None) for name in ("K_camera", "size_camera", "K_projector", "size_projector")),
    *((name, None) for name in ("R", "T")),
    ("K_camera", NAN),
    ("K_camera", np.eye(2)),
    ("K_camera", SKEWED),
    ("K_camera", TRANSPOSED),
    ("K_camera", -np.eye(3)),
    ("K_camera", "text"),
    ("K_projector", 7.0),
    ("size_camera", np.array([640.0])),
    ("size_camera", np.array([640.5, 480.0])),
    ("size_camera", np.array([0.0, 480.0])),
    ("dist_camera", np.zeros(6)),
    ("dist_camera", np.full(8, 1e12)),
    ("dist_camera", np.concatenate((np.zeros(12), [2.0, 0.0]))),
    ("R", np.diag([1.0, 1.0, -1.0])),
    ("R", 2.0 * np.eye(3)),
    ("R", NAN),
    ("T", np.zeros(4)),
    ("R_world", np.eye(2)),
    ("R_world", 2.0 * np.eye(3)),
    ("T_world", np.full(3, np.inf)),
    ("pitch_um_camera", np.array([5.0])),
    ("pitch_um_camera", np.array([-5.0, 5.0])),
    ("aperture_radius_mm_camera", -1.0),
    ("aperture_radius_mm_projector", "wide"),
    ("focus_distance_mm_camera", 0.0),
    ("focus_distance_mm_projector", -3.0),
    ("focus_distance_mm_camera", -np.inf),
    ("focus_distance_mm_camera", "far"),
    ("body_mm_camera", np.array([50.0, 40.0])),
    ("body_mm_projector", np.array([50.0, -40.0, 70.0])),
    ("lens_camera", "fisheye"),
    ("natural_vignetting_camera", "maybe"),
    ("natural_vignetting_projector", 7),
    ("flux_w", 0.0),
    ("flux_w", "bright"),
    ("bit_depth_projector", 40),
    ("bit_depth_projector", -1),
    ("bit_depth_projector", 7.5),
    ("gamma_projector", -1.0),
    ("volume_mm", np.array([1.0, 2.0])),
    ("volume_mm", np.array([1.0, 2.0, 0.0])),
]


@pytest.mark.parametrize(("key", "value"), BAD, ids=[f"{k}-{i}" for i, (k, _) in enumerate(BAD)])
def test_a_bad_value_is_one_line_that_names_file_and_key(key, value, tmp_path):
    values = plain() | {"R_world": np.eye(3), "T_world": np.zeros(3)} | {key: value}
    path = written(tmp_path / "rig.yml", values)
    with pytest.raises(InputError) as caught:
        read_rig(path)
    line = str(caught.value)
    assert "\n" not in line
    assert str(path) in line
    assert key in line, line


@pytest.mark.parametrize(
    ("key", "value"), [("model", "fisheye"), ("camera_model", "Kannala-Brandt"), ("fisheye", 1)]
)
def test_lenses_of_other_models_are_refused_by_name(key, value, tmp_path):
    path = written(tmp_path / "rig.yml", plain() | {key: value})
    with pytest.raises(InputError, match=rf"rig.yml: {key}: expected OpenCV's pinhole"):
        read_rig(path)


@pytest.mark.parametrize("key", ["K_camera", "T", "lens_camera", "name_camera", "flux_w"])
@pytest.mark.parametrize("entry", ['[ "a", "b" ]', "{ b: 1 }"])
def test_a_needed_entry_of_another_structure_is_named(key, entry, tmp_path):
    path = written(tmp_path / "rig.yml", plain() | {key: None})
    with path.open("a") as stream:
        stream.write(f"{key}: {entry}\n")
    with pytest.raises(InputError, match=rf"rig.yml: {key}: .*a list, a map"):
        read_rig(path)


class TestFocus:
    """A lens with an aperture in a file that states no focus distance."""

    def test_is_on_the_world_s_origin(self, tmp_path):
        path = tmp_path / "rig.yml"
        write_rig(path, RIG)
        values = {k: v for k, v in read_opencv_yaml(path).items() if "focus_distance" not in k}
        rig = read_rig(written(path, values))
        for device in (rig.camera, rig.projector):
            (depth,) = device.pose.to_local(np.zeros((1, 3)))[:, 2]
            assert device.lens.focus_distance_mm == pytest.approx(depth, rel=1e-12)
        # The camera looks at the origin, so that it is seen sharp.
        assert rig.camera.circle_of_confusion(np.zeros(3)) < 1e-9

    def test_at_infinity_is_said_where_the_origin_is_the_camera(self, tmp_path):
        values = plain() | {"aperture_radius_mm_camera": 2.0, "aperture_radius_mm_projector": 2.0}
        with pytest.warns(InputWarning, match="focus_distance_mm_.*in focus at infinity") as said:
            rig = read_rig(written(tmp_path / "rig.yml", values))
        assert len(said) == 2
        assert rig.camera.lens.focus_distance_mm == rig.projector.lens.focus_distance_mm == np.inf

    def test_at_infinity_comes_back(self, tmp_path):
        far = replace(RIG.camera, lens=Lens(16.0, 2.0))
        write_rig(tmp_path / "rig.yml", replace(RIG, cameras={"camera": far}))
        assert read_rig(tmp_path / "rig.yml").camera.lens.focus_distance_mm == np.inf


def test_a_telecentric_lens_needs_its_focus_distance(tmp_path):
    values = plain() | {"lens_projector": "telecentric"}
    with pytest.raises(InputError, match="focus_distance_mm_projector: expected a finite dist"):
        read_rig(written(tmp_path / "rig.yml", values))


def test_half_a_world_is_refused(tmp_path):
    for key in ("R_world", "T_world"):
        values = plain() | {"R_world": np.eye(3), "T_world": np.zeros(3)} | {key: None}
        with pytest.raises(InputError, match=f"{key}: expected this key to be present"):
            read_rig(written(tmp_path / "rig.yml", values))


def test_files_that_are_none(tmp_path):
    with pytest.raises(InputError, match=r"missing\.yml"):
        read_rig(tmp_path / "missing.yml")
    (tmp_path / "broken.yml").write_text("%YAML:1.0\n---\nK_camera: [1, 2\n")
    with pytest.raises(InputError, match=r"broken\.yml"):
        read_rig(tmp_path / "broken.yml")
    with pytest.raises(InputError, match=r"rig\.txt: expected a name that ends in"):
        write_rig(tmp_path / "rig.txt", RIG)


SEVERAL = Rig(
    {"left": RIG.camera, "right_2": replace(TELECENTRIC.camera, shading=(0.1, -0.2))},
    {"main": RIG.projector, "side": replace(PROJECTOR, flux_w=0.5, gamma=1.0)},
    (50.0, 40.0, 20.0),
)
#: Two cameras as ``cv2.stereoCalibrate`` has them: the first one's frame is the world.
ALONE = Rig({"left": CAMERA, "right": replace(CAMERA, pose=RIG.projector.pose)}, {})


@pytest.mark.parametrize("rig", [SEVERAL, ALONE], ids=["two and two", "cameras alone"])
def test_rigs_of_several_devices_come_back_by_name(rig, tmp_path):
    write_rig(tmp_path / "rig.yaml", rig)
    read = read_rig(tmp_path / "rig.yaml")
    assert list(read.devices) == list(rig.devices)
    for names in zip(read.cameras, read.projectors or rig.projectors, strict=False):
        pairs = [
            Rig(one.cameras[names[0]], one.projectors[names[1]], one.volume_mm)
            for one in (read, rig)
        ]
        assert_same(*pairs)
    for name, camera in rig.cameras.items():
        assert read.cameras[name].shading == camera.shading
        points = camera.pose.to_world(np.array([[5.0, -3.0, 400.0], [0.0, 8.0, 500.0]]))
        np.testing.assert_allclose(
            read.cameras[name].project(points), camera.project(points), rtol=0.0, atol=1e-9
        )


def test_the_first_of_several_devices_is_the_world_unless_it_says_where_it_stands(tmp_path):
    path = tmp_path / "rig.yaml"
    write_rig(path, ALONE)
    lines = path.read_text().splitlines()
    start = lines.index("R_left: !!opencv-matrix")
    end = next(k for k in range(start, len(lines)) if lines[k].startswith("K_right"))
    path.write_text("\n".join(lines[:start] + lines[end:]) + "\n")
    assert np.array_equal(read_rig(path).cameras["left"].pose.rotation, np.eye(3))
    path.write_text(path.read_text().replace("R_right", "R_rihgt"))
    with pytest.warns(InputWarning, match="R_rihgt.*did you mean 'R_right'"):  # noqa: SIM117
        with pytest.raises(InputError, match="R_right: expected this key"):
            read_rig(path)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("cameras: left right", "cameras: left left", "each name once"),
        ("cameras: left right", "cameras: left", "a name of its own"),
        ("cameras: left right", "cameras: left wrong", "K_wrong|R_wrong"),
        ("lens_right: perspective", "lens_right: persective", "lens_right"),
    ],
)
def test_files_of_several_devices_that_say_what_is_wrong(old, new, expected, tmp_path):
    path = tmp_path / "rig.yaml"
    write_rig(path, ALONE)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=expected):
        read_rig(path)


def test_what_no_file_of_several_devices_can_hold(tmp_path):
    named = Rig({"left eye": CAMERA, "right": RIG.camera}, {})
    with pytest.raises(InputError, match="letters, digits"):
        write_rig(tmp_path / "rig.yaml", named)
    with pytest.raises(InputError, match="no projector"):
        _ = ALONE.projector
