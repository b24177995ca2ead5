"""Whole scans: against the artefacts' dimensions, geometry and radiometry on paper."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import at, scene_of, small, transport_of, truth_of
from scipy.spatial import ConvexHull
from stages import capture, floor_rms_px, noise_free_coordinates, trace

from slbench import objects
from slbench.core.errors import InputError
from slbench.core.io import read_json, read_ply
from slbench.detector.emva1288 import Detector
from slbench.objects import Artefact, Mesh
from slbench.patterns import PatternSequence
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.scene.file import load_scene
from slbench.scene.model import Exposure, Light, Scene, SceneObject
from slbench.scene.surfaces.bsdfs import Diffuse
from slbench.scene.surfaces.materials import Material
from slbench.scene.truth import GroundTruth, Status
from slbench.score.points import point_errors
from slbench.simulate.folder import write_scan
from slbench.simulate.scan import scan, score_scan


@functools.cache
def scanned(name, noise=True, axes="u", divisor=4, seed=0):
    return scan(small(name, axes=axes, divisor=divisor), seed=seed, noise=noise)


# -- bias and floor ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "axes"), [("plane", "u"), ("plane", "v"), ("plane", "uv"), ("step-block", "u")]
)
def test_noise_free_coordinates_have_no_bias(name, axes):
    result = scanned(name, noise=False, axes=axes)
    assert result.capture.frames.dtype == np.uint8
    for axis in axes:
        # The required 0.01 px.  Over 10,000 pixels whose errors of 0.07 px go together along
        # 100 or so lines the mean has a standard error of some 0.001 px.
        assert abs(result.score.smooth_bias_px[axis]) < 0.01
    assert 0.001 < result.floor_rms_px < 0.1
    assert result.to_dict()["floor_rms_px"] == result.floor_rms_px


def test_the_floor_falls_with_samples_down_to_the_square_pixels():
    scene = small("plane")
    few, many = (
        floor_rms_px(scene, transport_of("plane", samples=n), truth_of("plane")) for n in (4, 144)
    )
    # Strata: the Monte Carlo part falls faster than 1 / sqrt(36); what is left of the rest is
    # the quantised panel, 3 x 8 bit, and what blur leaves of its square pixels.
    assert many < 0.8 * few
    assert many > 0.001


def test_without_lit_smooth_pixels_there_is_no_floor():
    truth = replace(truth_of("plane"), status=np.zeros_like(truth_of("plane").status))
    assert np.isnan(floor_rms_px(small("plane"), transport_of("plane"), truth))


# -- artefacts -------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [False, True])
def test_step_heights_within_their_uncertainty(noise):
    steps = scanned("step-block", noise).score.steps
    assert [step.nominal_mm for step in steps] == [1.0, 2.5, 5.0]
    for step in steps:
        # Three standard uncertainties: false alarms 0.3 % a step, with a fixed seed.
        assert abs(step.measured_mm - step.nominal_mm) < 3 * step.uncertainty_mm
        # A useful statement, not one that covers everything.
        assert step.uncertainty_mm < 0.01
        assert step.points > 200


@pytest.mark.parametrize("noise", [False, True])
def test_sphere_radius_within_its_uncertainty(noise):
    # The shipped camera: pixels of 0.8 mm would average over too much of the ball.
    sphere = scanned("sphere", noise, divisor=1).score.spheres[0]
    assert sphere.points > 3000
    assert abs(sphere.radius_mm - 12.5) < 3 * sphere.radius_uncertainty_mm
    assert sphere.radius_uncertainty_mm < 0.01
    # The centre has three coordinates, each about as well known as the radius along the view.
    assert sphere.centre_error_mm < 6 * sphere.radius_uncertainty_mm


def test_sphere_form_is_the_floor_and_the_noise():
    quiet, noisy = (scanned("sphere", noise, divisor=1) for noise in (False, True))
    cloud, truth = noisy.cloud, noisy.truth
    rows, columns = cloud.pixels[:, 1], cloud.pixels[:, 0]
    ball = (truth.object_id == 0)[rows, columns] & truth.smooth()[rows, columns]
    # The part of the predicted deviation that is normal to the sphere.
    normal = np.sum(cloud.sensitivity[ball, 0] * truth.normal[rows, columns][ball], axis=-1)
    predicted = np.sqrt(np.mean((normal * cloud.sigma_px[ball, 0]) ** 2))
    before, after = quiet.score.spheres[0], noisy.score.spheres[0]
    # Smooth pixels stand for all; those at the rim are noisier: 10 %.  Without noise, rounding to
    # 8 bits is an error of its own, which noise dithers and the prediction has already.
    assert 0.75 * predicted < after.std_mm < 1.1 * np.hypot(before.std_mm, predicted)
    # The range of 10,000 residuals without the outermost 0.3 %: no more than six deviations of
    # the noise wider, and never narrower by as much.
    assert abs(after.form_mm - before.form_mm) < 6 * predicted
    # Without noise what stands out are pixels at the rim, 0.1 mm in a pixel of 0.4 mm.
    assert before.form_mm < 0.1


def test_plane_errors_are_floor_and_noise():
    result = scanned("plane")
    cloud, truth = result.cloud, result.truth
    smooth = truth.smooth()[cloud.pixels[:, 1], cloud.pixels[:, 0]]
    floor = noise_free_coordinates(result.scene, result.transport)["u"] - truth.panel[..., 0]
    own = floor[cloud.pixels[:, 1], cloud.pixels[:, 0]][smooth]
    step = np.linalg.norm(cloud.sensitivity[smooth, 0], axis=-1)
    expected = np.sqrt(np.mean(step**2 * (own**2 + cloud.sigma_px[smooth, 0] ** 2)))
    # 10,000 pixels: 1 % of a standard deviation; the cross term of floor and noise as much.
    assert result.score.smooth_rms_mm == pytest.approx(expected, rel=0.04)
    assert result.score.completeness > 0.99


# -- shadow and occlusion -----------------------------------------------------------------------


def post(x, y, height):
    """Return a post on the plane z = 0 as an object, and its corners."""
    corners = np.array(np.meshgrid(x, y, (0.0, height))).reshape(3, -1).T
    hull = ConvexHull(corners)
    faces = hull.simplices.copy()
    a, b, c = np.moveaxis(corners[faces], 1, 0)
    inward = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Artefact("post", "mesh", {}, Mesh(corners, faces), {}), corners


def test_no_points_in_the_shadow():
    artefact, corners = post((-5.0, 5.0), (-6.0, 6.0), 40.0)
    scene = scene_of([at(objects.load_artefact("plane")), at(artefact)])
    result = scan(scene, seed=1)
    source = scene.rig.projector.pose.position
    beam = corners - source
    feet = (corners - corners[:, 2:] / beam[:, 2:] * beam)[:, :2]
    equations = ConvexHull(feet).equations
    place = result.truth.point[..., :2]
    depth_inside = -np.max(place @ equations[:, :2].T + equations[:, 2], axis=-1)
    floor = (result.truth.object_id == 0) & (np.abs(result.truth.point[..., 2]) < 1e-9)
    # The shadow's edge is blurred by the projector's aperture of 11 mm at 40 mm above the
    # floor, 0.6 mm; the camera's pixel of 0.9 mm looks beyond it by half.
    umbra = floor & (depth_inside > 1.5)
    penumbra = floor & (np.abs(depth_inside) <= 1.5)
    lit = floor & (depth_inside < -1.5) & (result.truth.status != Status.OUTSIDE)
    assert umbra.sum() > 100
    assert (result.truth.status[umbra] == Status.SHADOWED).all()
    assert not result.phase.mask[umbra].any()
    measured = np.isfinite(result.cloud.image(result.cloud.points)[..., 0])
    assert not measured[umbra].any()
    assert (result.truth.status[lit] == Status.LIT).all()
    # Errors of the fringe order and edges of the picture aside, all that is lit is measured.
    assert measured[lit].mean() > 0.99
    assert result.score.false_points <= penumbra.sum() + np.count_nonzero(
        ~floor | (result.truth.status == Status.OUTSIDE)
    )


def test_noise_alone_is_not_decoded():
    # In the dark a detector with much read noise gives frames, but no coordinates.
    artefact, _ = post((-5.0, 5.0), (-6.0, 6.0), 40.0)
    scene = scene_of([at(objects.load_artefact("plane")), at(artefact)])
    scene = replace(scene, detector=Detector(read_noise_e=200.0))
    result = scan(scene, seed=2)
    dark = result.transport.white() == 0
    assert dark.sum() > 100
    frames = result.capture.frames[:, dark]
    assert frames.std() > 1.0
    # Per set and pixel the modulation of pure noise passes three times its deviation with a
    # probability of exp(-9 N / 4) = 0.1 %, three sets in a row never.
    assert not result.phase.mask[dark].any()


# -- interreflection ------------------------------------------------------------------------------


def groove(length=120.0, side=6.0):
    """Return a right-angled V groove along y, its bottom edge on the y axis."""
    depth = side / np.sqrt(2.0)
    x, y = (-depth, 0.0, depth), (-length / 2, length / 2)
    vertices = np.array([(a, b, abs(a)) for b in y for a in x])
    faces = np.array([(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)])
    return Artefact("groove", "mesh", {}, Mesh(vertices, faces), {})


def above():
    """Return a camera and a projector side by side, looking straight down on 16 x 12 mm."""
    camera = Camera(80, 60, (0.0128, 0.0128), Lens(32.0))
    projector = Projector(160, 120, (0.0128, 0.0128), Lens(28.0, natural_vignetting=False))
    down = (0.0, -1.0, 0.0)
    return Rig(
        camera.posed(Pose.looking_at((40.0, 0.0, 500.0), (0, 0, 0), down)),
        projector.posed(Pose.looking_at((-40.0, 0.0, 500.0), (0, 0, 0), down)),
    )


def test_a_groove_lights_itself():
    albedo = 0.8
    item = SceneObject(groove(), Pose(), Material(Diffuse(albedo=albedo)))
    rig = above()
    sequence = PatternSequence.parse("1", (160, 120))
    images = []
    for bounces in (0, 1, 8):
        scene = Scene("groove", rig, (item,), sequence, light=Light(bounces=bounces), samples=256)
        images.append(trace(scene).white().astype(float))
    origins, directions = rig.camera.unproject(rig.camera.pixel_grid())
    # On the two faces z = |x|, met by hand.
    sides = []
    for sign in (-1.0, 1.0):
        normal = np.array([-sign, 0.0, 1.0])
        t = -(origins @ normal) / (directions @ normal)
        point = origins + t[..., None] * directions
        x = sign * point[..., 0]
        sides.append((x > 0.0) & (x < 6.0 / np.sqrt(2.0)))
    assert not (sides[0] & sides[1]).any()
    gain = []
    for image in images[1:]:
        lit = [np.mean(image[side]) for side in sides]
        direct = [np.mean(images[0][side]) for side in sides]
        gain.append(sum(lit) / sum(direct))
    # Two equal plates at a right angle see each other with F = 1 - sin(45 deg) (Hottel); one
    # bounce returns rho F of what fell on either, all of them 1 / (1 - rho F).  Edge pixels see
    # both faces or none and the pixels weigh the faces' parts nearly alike: 2 %.
    form_factor = 1.0 - np.sin(np.pi / 4)
    assert gain[0] == pytest.approx(1.0 + albedo * form_factor, rel=0.02)
    assert gain[1] == pytest.approx(1.0 / (1.0 - albedo * form_factor), rel=0.02)


# -- radiometry -----------------------------------------------------------------------------------


def test_absolute_exposure_is_the_hand_calculation():
    """Flux to irradiance to radiance to photons to digital numbers, on a plane that faces."""
    albedo, flux, time = 0.6, 0.012, 0.008
    height_camera, height_projector = 400.0, 640.0
    down = (0.0, -1.0, 0.0)
    focal, radius, pitch = 16.0, 2.0, 0.01
    camera = Camera(
        40,
        30,
        (pitch, pitch),
        Lens(focal, radius, height_camera),
        pose=Pose.looking_at((0, 0, height_camera), (0, 0, 0), down),
    )
    panel = Projector(
        160,
        120,
        (0.04, 0.04),
        Lens(28.0, 3.0, height_projector, natural_vignetting=False),
        pose=Pose.looking_at((0, 0, height_projector), (0, 0, 0), down),
        flux_w=flux,
    )
    detector = Detector(
        bit_depth=12,
        full_well_e=20_000.0,
        quantum_efficiency=0.55,
        wavelength_nm=532.0,
        dark_current_e_per_s=0.0,
        offset_dn=50.0,
        gain_e_per_dn=4.0,
    )
    scene = Scene(
        "facing",
        Rig(camera, panel),
        (at(objects.build_artefact("plane", {"size_mm": (300.0, 300.0)}), albedo=albedo),),
        PatternSequence.parse("white+1", (160, 120)),
        detector,
        Exposure(time_s=time),
        samples=64,
    )
    frame = capture(scene, trace(scene), noise=False).frames[0]

    # The flux spreads evenly over the panel's picture, 28 mm scaled up to the plane.
    width = 160 * 0.04 * height_projector / 28.0
    irradiance = flux / (width * width * 120 / 160)  # W / mm^2
    radiance = albedo * irradiance / np.pi
    # A pixel's patch on the plane sees the entrance pupil.
    patch = (pitch * height_camera / focal) ** 2
    solid_angle = np.pi * radius**2 / height_camera**2
    joules = radiance * patch * solid_angle * time
    photons = joules / (6.62607015e-34 * 299792458.0 / 532e-9)
    expected = 50.0 + 0.55 * photons / 4.0
    assert 1000 < expected < 4000
    # Pixels near the axis, where cos^4 is above 0.9999; 1 % as required.
    centre = frame[13:17, 18:22].astype(float).mean()
    assert centre == pytest.approx(expected, rel=0.01)
    # And on the axis the estimate is far better than that: Monte Carlo over 16 pixels.
    assert centre == pytest.approx(expected, rel=0.002)


def test_automatic_exposure_reaches_the_white_level():
    scene = small("plane", patterns="white+1,10")
    detector = Detector(bit_depth=12, prnu=0.0, dsnu_e=0.0, dark_current_e_per_s=0.0)
    scene = replace(scene, detector=detector, exposure=Exposure(white_level=0.6))
    transport = transport_of("plane")
    frame = capture(scene, transport, noise=False).frames[0].astype(float)
    lit = transport.white() > 0
    level = (np.percentile(frame[lit], 99) - detector.black_dn) / (4095 - detector.black_dn)
    assert level == pytest.approx(0.6, abs=1e-3)


def test_ambient_light_lowers_contrast_but_not_coordinates():
    scene = small("plane")
    # 0.03 W/m^2: about what the 1 W projector sheds on 0.2 m x 0.2 m would be 25 W/m^2.
    bright = replace(scene, light=Light(ambient_w_per_mm2=1e-5))
    dark, lit = (trace(s, seed=0) for s in (scene, bright))
    assert np.all(dark.ambient == 0)
    np.testing.assert_allclose(
        np.median(lit.ambient[lit.white() > lit.ambient]),
        0.85 * 1e-5 / np.pi,  # albedo x irradiance / pi, the camera's fall-off aside
        rtol=0.1,
    )
    first, second = (noise_free_coordinates(s, t)["u"] for s, t in ((scene, dark), (bright, lit)))
    both = np.isfinite(first) & np.isfinite(second)
    # The same strata, other random numbers further down the path at most.
    difference = (second - first)[both]
    assert abs(np.mean(difference)) < 0.002
    contrast = []
    for s, t in ((scene, dark), (bright, lit)):
        phase = capture(s, t, noise=False).decode()
        mean = (phase.mean - s.detector.black_dn)[phase.mask]
        contrast.append(np.median(phase.modulation[phase.mask] / mean))
    white = np.median((lit.white() - lit.ambient)[lit.white() > lit.ambient])
    share = np.median(lit.ambient[lit.white() > lit.ambient]) / (0.5 * white)
    # b / a falls as the mean rises by the ambient light: medians over the picture, 5 %.
    assert contrast[1] / contrast[0] == pytest.approx(1.0 / (1.0 + share), rel=0.05)


# -- the result as a whole ------------------------------------------------------------------------


def test_a_scan_is_what_its_parts_are():
    result = scanned("step-block")
    assert set(result.run.seconds) == {
        "trace",
        "truth",
        "relight",
        "fuse",
        "decode",
        "reconstruct",
        "score",
        "total",
    }
    parts = sum(value for key, value in result.run.seconds.items() if key != "total")
    assert parts <= result.run.seconds["total"] < parts + 0.5
    plain = result.to_dict()
    assert plain["points"] == len(result.cloud)
    assert plain["frames"] == 9
    assert plain["patterns"] == "1,10,50"
    again = scan(small("step-block"), seed=0)
    np.testing.assert_array_equal(again.capture.frames, result.capture.frames)
    np.testing.assert_array_equal(again.cloud.points, result.cloud.points)
    other = scan(small("step-block"), seed=1)
    assert np.mean(other.capture.frames != result.capture.frames) > 0.1
    np.testing.assert_array_equal(other.truth.status, result.truth.status)


def test_progress_names_the_stages_in_order():
    seen = []
    scan(small("plane"), on_progress=lambda stage, done: seen.append((stage, done)))
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    assert stages == ["trace", "truth", "relight", "fuse", "decode", "reconstruct", "score"]
    for stage in stages:
        fractions = [done for name, done in seen if name == stage]
        assert fractions == sorted(fractions)
        assert fractions[0] == 0.0
        assert fractions[-1] == 1.0


def test_samples_override_the_scene():
    result = scan(small("plane"), samples=4, noise=False)
    assert result.transport.samples == result.scene.samples == 4


def test_scores_may_be_left_out_and_made_later():
    with_scores = scanned("step-block")
    result = scan(small("step-block"), score=False)
    assert result.scores is None
    assert "score" not in result.run.seconds
    assert result.to_dict()["points"] == len(with_scores.cloud)
    assert "rms_mm" not in result.to_dict()
    for name in ("score", "floor_rms_px", "fusion"):
        with pytest.raises(InputError, match="score_scan"):
            getattr(result, name)
    scored = score_scan(result)
    assert scored.scores == with_scores.scores
    np.testing.assert_array_equal(scored.cloud.u_mm, with_scores.cloud.u_mm)
    # Nothing is known twice.
    assert score_scan(scored) is scored


def test_a_scan_has_a_view_of_each_pair():
    result = scanned("plane")
    assert list(result.views) == [("camera", "projector")]
    assert result.view.phase is result.phase
    rig = result.scene.rig
    two = Rig({"left": rig.camera, "right": rig.camera}, rig.projector)
    with pytest.raises(InputError, match="left, right"):
        scan(replace(result.scene, rig=two))


def test_devices_keep_their_names_through_a_scan():
    scene = small("plane", divisor=16)
    named = Rig({"left": scene.rig.camera}, {"beamer": scene.rig.projector}, scene.rig.volume_mm)
    result = scan(replace(scene, rig=named), score=False)
    assert result.capture.pair == ("left", "beamer")
    expected = scan(scene, score=False)
    np.testing.assert_array_equal(result.cloud.points, expected.cloud.points)


def test_files_hold_the_result(tmp_path):
    # The picture takes longer than the scan; test_cli looks at it.
    result = scanned("step-block")
    folder = tmp_path / "deep" / "out"
    written = write_scan(result, folder, picture=False)
    assert {path.name for path in written} == {path.name for path in folder.iterdir()}
    assert all(path.exists() for path in written)
    points, fields = read_ply(folder / "cloud.ply")
    # PLY is in single precision.
    np.testing.assert_array_equal(points, result.cloud.points.astype(np.float32))
    np.testing.assert_array_equal(fields["sigma"], result.cloud.sigma_total_mm.astype(np.float32))
    error = point_errors(result.cloud, result.truth)[:, 2]
    np.testing.assert_array_equal(fields["error"], error.astype(np.float32))
    truth = GroundTruth.load(folder / "truth.exr")
    np.testing.assert_array_equal(truth.status, result.truth.status)
    score = read_json(folder / "score.json")
    assert score == json.loads(json.dumps(result.to_dict()))
    provenance = read_json(folder / "provenance.json")
    assert provenance["seed"] == 0
    assert provenance["parameters"]["patterns"] == result.scene.sequence.to_dict()
    assert provenance["parameters"]["samples"] == 16
    # A second result replaces the first, file by file, and leaves nothing else behind.
    write_scan(scanned("step-block", noise=False), folder, picture=False)
    assert {path.name for path in folder.iterdir()} == {path.name for path in written}
    assert list(folder.parent.iterdir()) == [folder]


def test_a_failing_write_leaves_the_folder_as_it_was(tmp_path, monkeypatch):
    write_scan(scanned("plane"), tmp_path / "out", picture=False)
    before = (tmp_path / "out" / "cloud.ply").read_bytes()

    def fail(*_):
        raise InputError("figure", "paper", "none")

    monkeypatch.setattr("slbench.simulate.folder.write_figure", fail)
    for name in ("out", "new"):
        with pytest.raises(InputError):
            write_scan(scanned("plane", noise=False), tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "cloud.ply").read_bytes() == before


def test_a_scene_without_points_is_scored_and_written(tmp_path):
    # So little light and so many fringes that nothing passes the mask.
    scene = replace(small("plane"), exposure=Exposure(white_level=0.005))
    result = scan(scene, samples=4)
    assert result.score.points == 0
    write_scan(result, tmp_path / "out")
    assert read_json(tmp_path / "out" / "score.json")["rms_mm"] is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plane", "sphere", "step-block"])
def test_shipped_scenes_as_they_are(name):
    scene = load_scene(name)
    result = scan(scene, seed=0)
    assert result.score.completeness > 0.99
    assert result.floor_rms_px < 0.1
    for step in result.score.steps:
        assert abs(step.measured_mm - step.nominal_mm) < 3 * step.uncertainty_mm
    for sphere in result.score.spheres:
        assert abs(sphere.radius_mm - 12.5) < 3 * sphere.radius_uncertainty_mm


def test_patterns_that_cannot_be_decoded_are_refused_before_anything_is_traced():
    stages = []
    scene = load_scene("plane", preview=True).with_patterns("2,10")
    with pytest.raises(InputError, match=r"scene plane: patterns 2,10: .*one fringe") as caught:
        scan(scene, on_progress=lambda stage, fraction: stages.append(stage))
    assert caught.value.got == "2, 10 fringes"
    assert not stages
