"""views.toml: written, read, refused; scenes with the part alone."""

import numpy as np
import pytest
from scenes_small import small
from view_parts import l_block

from slbench.core.errors import InputError
from slbench.rig import Pose
from slbench.scene.file import load_scene
from slbench.simulate.viewpoints.scenes import named_files, write_scenes
from slbench.simulate.viewpoints.views import (
    Counting,
    Viewpoint,
    Viewpoints,
    alone,
    inside_volume,
    moved,
    names_of,
    read_views,
)


def turned(axis, degrees):
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(np.deg2rad(degrees) * np.array(axis, float)).as_matrix()


def test_what_is_written_is_read(tmp_path):
    pose = Pose(turned((0.6, 0.0, 0.8), 77.0), np.array([1.0 / 3.0, -2e-7, 5.0]))
    gimbal = Pose(turned((0, 1, 0), 90.0), np.zeros(3))
    views = (Viewpoint("a", pose, "somewhere"), Viewpoint("b", gimbal))
    counting = Counting(min_measurements=2, max_std_mm=0.02, within_volume=False, samples=1234)
    Viewpoints(views, counting, 1, "plane", "brick", 0.75).write(tmp_path / "views.toml")
    read = read_views(tmp_path / "views.toml")
    assert read.counting == counting
    assert (read.object, read.scene, read.part) == (1, "plane", "brick")
    assert read.predicted_coverage == 0.75
    for before, after in zip(views, read.views, strict=True):
        assert (before.name, before.description) == (after.name, after.description)
        assert np.allclose(before.pose.rotation, after.pose.rotation, atol=1e-14)
        assert np.array_equal(before.pose.position, after.pose.position)


def test_views_written_by_hand_need_positions_alone(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('[[views]]\nname = "one"\nposition_mm = [0, 0, 5]\n')
    read = read_views(path)
    assert len(read) == 1
    assert read.counting == Counting()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "views"),
        ("views = []", "views"),
        ('[[views]]\nname = "a/b"\nposition_mm = [0, 0, 0]', "views"),
        ('[[views]]\nname = "a"\npositions_mm = [0, 0, 0]', "position_mm"),
        ('[[views]]\nname = "a"\nposition_mm = [0, 0, inf]', "position_mm"),
        ('min_measurements = 0\n[[views]]\nname = "a"\nposition_mm = [0, 0, 0]', "min_measure"),
        (
            '[[views]]\nname = "a"\nposition_mm = [0, 0, 0]\n'
            '[[views]]\nname = "a"\nposition_mm = [0, 0, 1]',
            "two of a",
        ),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "views.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_views(path)
    assert "\n" not in str(caught.value)
    assert "views.toml" in str(caught.value)


def test_the_part_is_alone_in_its_pose():
    scene = small("step-block")
    pose = Pose(turned((1, 0, 0), 30.0), np.array([1.0, 2.0, 3.0]))
    one = alone(scene, 0, pose)
    assert len(one.objects) == 1
    assert one.objects[0].pose == pose
    (table,) = one.specification["objects"]
    assert table["artefact"] == "step-block-5"
    assert np.allclose(table["rotation_deg"], [30.0, 0.0, 0.0])
    assert alone(scene, 1).objects[0] is scene.objects[1]
    with pytest.raises(InputError, match="one of the 2 objects"):
        alone(scene, 2)


def test_a_rig_moved_against_the_part_sees_the_same():
    rig = small("plane").rig
    pose = Pose(turned((0.0, 0.6, 0.8), 50.0), np.array([3.0, -4.0, 5.0]))
    points = np.array([[1.0, 2.0, 3.0], [-5.0, 0.0, 2.0]])
    near = moved(rig, pose.inverse)
    for name, device in rig.devices.items():
        expected = device.project(pose.to_world(points))
        assert np.allclose(near.devices[name].project(points), expected, atol=1e-9)


def test_scenes_of_single_views_stand_alone(tmp_path):
    home, away = tmp_path / "home", tmp_path / "away"
    (home / "parts").mkdir(parents=True)
    away.mkdir()
    l_block().mesh.as_trimesh.export(home / "parts" / "block.stl")
    (home / "parts" / "block.toml").write_text(
        'kind = "mesh"\nsource = "drawn"\n[parameters]\npath = "block.stl"\nunit = "mm"\n'
    )
    (home / "mine.toml").write_text(
        'extends = "hardware/macro-ch6"\nname = "mine"\n'
        '[[objects]]\nartefact = "parts/block.toml"\nmaterial = "matt-white-spray"\n'
        '[[objects]]\nartefact = "plane"\n'
    )
    scene = load_scene(home / "mine.toml", changes=["camera.f_number=8"])
    pose = Pose(turned((1, 0, 0), 30.0), np.array([1.0, 2.0, 3.0]))
    views = Viewpoints((Viewpoint("view-01", pose, "leant"),))
    (written,) = write_scenes(away, scene, views, home / "mine.toml")
    assert sorted(named_files(scene.specification, home)) == ["parts/block.stl", "parts/block.toml"]
    read = load_scene(written)
    (part,) = read.objects
    assert np.allclose(part.pose.rotation, pose.rotation, atol=1e-14)
    assert np.array_equal(part.artefact.mesh.vertices, scene.objects[0].artefact.mesh.vertices)
    assert read.rig.camera == scene.rig.camera
    assert read.sequence.name == scene.sequence.name


def test_the_volume_is_about_its_place():
    rig = small("plane").rig
    half = 0.5 * np.array(rig.volume_mm)
    place = Pose(turned((0, 0, 1), 90.0), np.array([10.0, 0.0, 0.0]))
    points = place.to_world(np.array([0.999 * half, 1.001 * half, [0.0, 0.0, 0.0]]))
    assert inside_volume(rig, place, points).tolist() == [True, False, True]


def test_names_sort_as_their_numbers():
    names = names_of(12)
    assert names == sorted(names)
    assert names[0] == "view-01"
    assert names_of(100)[0] == "view-001"
