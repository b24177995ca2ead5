"""Whole plans: candidates, choices on ten parts, and coverage against scans."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from view_parts import above, l_block, part_scene, shipped_part

from slbench.core.errors import InputError, InputWarning
from slbench.design.rig.hardware import load_hardware
from slbench.design.views.candidates import Staging, candidates, uniform_turntables
from slbench.design.views.cover import Rows
from slbench.design.views.plan import GREEDY, INTEGER, best_of, choose, plan_views
from slbench.rig import Pose
from slbench.simulate.viewpoints.scan import scan_views
from slbench.simulate.viewpoints.views import Counting

SMALL = Counting(samples=1000, within_volume=False)
TEN = (
    *("engine-block", "brick", "feature-plate", "propeller-3", "spur-gear", "curved-gear"),
    *("bowl", "pyramid-array", "step-block-5", "l-block"),
)


def scene_with(name, divisor=4):
    return part_scene(l_block(), divisor) if name == "l-block" else shipped_part(name, divisor)


# -- candidates ---------------------------------------------------------------------------------


@pytest.mark.parametrize("stage", ["rotary", "robot"])
def test_a_part_stands_on_its_table_in_the_middle_of_the_volume(stage):
    scene = part_scene(l_block())
    found = candidates(scene, Staging(stage=stage, count=60, stable_poses=2))
    assert {one.resting for one in found} == {0, 1}
    mesh = l_block().mesh
    for one in found:
        on_table = one.table.to_local(one.pose.to_world(mesh.vertices))
        assert on_table[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        assert np.count_nonzero(on_table[:, 2] < 1e-6) >= 4
        assert np.linalg.norm(one.pose.to_world(mesh.bounds.mean(axis=0))) < 0.5 * np.sqrt(3) * 40


def test_a_turntable_turns_about_an_axis_that_leans():
    staging = Staging(count=24, stable_poses=1, tilt_deg=30.0)
    found = candidates(part_scene(l_block()), staging)
    assert len(found) == 24
    axis = np.array([0.0, -np.sin(np.pi / 6), np.cos(np.pi / 6)])
    for before, after in itertools.pairwise(found):
        assert np.allclose(before.table.rotation[:, 2], axis)
        turn = after.pose.rotation @ before.pose.rotation.T
        assert np.allclose(turn @ axis, axis)
        assert np.trace(turn) == pytest.approx(1.0 + 2.0 * np.cos(2.0 * np.pi / 24))
    turns = uniform_turntables(found, 7)
    assert turns[4] == [0, 6, 12, 18]
    assert 5 not in turns
    assert 7 not in turns


def test_a_robot_looks_from_all_over_a_hemisphere():
    found = candidates(part_scene(l_block()), Staging(stage="robot", count=400, stable_poses=1))
    # The line to the devices, the world's z, in the table's frame.
    eyes = np.array([one.table.rotation.T @ [0.0, 0.0, 1.0] for one in found])
    assert eyes[:, 2].min() > np.sin(np.deg2rad(20.0))
    # Even by area: heights are, and directions leave no gap of twice their spacing.
    heights = np.sort(eyes[::2, 2])
    assert np.allclose(np.diff(heights), np.diff(heights)[0], atol=1e-9)
    said = [re.search(r"azimuth (\S+)°, elevation (\S+)°", one.description) for one in found]
    azimuth, elevation = np.deg2rad([[float(n) for n in one.groups()] for one in said if one]).T
    around = np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation)
    # Words have four digits.
    np.testing.assert_allclose(eyes, np.stack((*around, np.sin(elevation)), axis=1), atol=2e-3)
    nearest = np.sort(np.arccos(np.clip(eyes[::2] @ eyes[::2].T, -1, 1)), axis=1)[:, 1]
    assert nearest.max() < 2.0 * np.median(nearest)


def test_shifts_bring_all_of_a_large_part_into_the_volume():
    scene = part_scene(l_block())
    scene = replace(scene, rig=type(scene.rig)(scene.rig.camera, scene.rig.projector, (20, 20, 20)))
    found = candidates(scene, Staging(stage="xyz", count=125))
    assert len(found) == 125
    assert not any(one.stands for one in found)
    inside = [
        np.all(np.abs(one.pose.to_world(l_block().mesh.vertices)) <= 10.0 + 1e-9, axis=1)
        for one in found
    ]
    assert np.any(inside, axis=0).all()


# -- plans --------------------------------------------------------------------------------------


def test_what_was_wanted_is_reached_with_fewer_views_than_all():
    scene = part_scene(l_block())
    staging = Staging(count=24, stable_poses=2)
    whole = plan_views(scene, 6, staging=staging, counting=SMALL)
    wanted = 0.7 * whole.reachable
    plan = plan_views(scene, 6, staging=staging, counting=SMALL, coverage=wanted)
    assert plan.coverage >= wanted - 1e-9
    assert len(plan.chosen) < len(whole.chosen)
    assert plan.curve(plan.by)[-1] == plan.coverage
    assert plan.counts.max() <= len(plan.chosen)
    assert np.mean(plan.counts >= 1) == pytest.approx(plan.coverage)
    found = plan.viewpoints()
    assert found.predicted_coverage == plan.coverage
    assert [view.name for view in found.views] == [f"view-0{k + 1}" for k in range(len(found))]


def test_what_cannot_be_reached_is_warned_of():
    with pytest.warns(InputWarning, match="all views together reach"):
        plan = plan_views(
            part_scene(l_block()),
            2,
            staging=Staging(count=12, stable_poses=1),
            counting=SMALL,
            coverage=1.0,
        )
    assert plan.wanted is None
    assert plan.reachable < 1.0


def test_two_measurements_cover_less_than_one():
    staging = Staging(count=24, stable_poses=1)
    once = plan_views(part_scene(l_block()), 2, staging=staging, counting=SMALL)
    twice = replace(SMALL, min_measurements=2)
    plan = plan_views(part_scene(l_block()), 2, staging=staging, counting=twice)
    assert 0.0 < plan.coverage < once.coverage
    assert np.mean(plan.counts >= 2) == pytest.approx(plan.coverage)


def test_margins_are_those_of_the_rig():
    scene = part_scene(l_block())
    hardware = load_hardware("hardware/macro-ch6")
    staging = Staging(count=12, stable_poses=1)
    plan = plan_views(scene, 1, staging=staging, counting=SMALL, hardware=hardware)
    assert plan.margins_mm is not None
    assert set(plan.margins_mm) == {f"g{k}" for k in range(1, 7)}
    assert min(plan.margins_mm.values()) > 0.0
    near = replace(hardware, camera_distance_mm=(300.0, 400.0))
    with pytest.warns(InputWarning, match="the rig violates g2"):
        plan_views(scene, 1, staging=staging, counting=SMALL, hardware=near)


def test_devices_without_bodies_are_questioned():
    scene = above(part_scene(l_block()), (300.0, 0.0, 500.0))
    with pytest.warns(InputWarning, match="no body_mm of camera and projector"):
        plan_views(scene, 1, staging=Staging(count=12, stable_poses=1), counting=SMALL)


def test_a_part_that_no_view_sees_is_refused():
    scene = above(part_scene(l_block()), (300.0, 0.0, 500.0))
    strict = replace(SMALL, max_std_mm=1e-9)
    with (
        pytest.warns(InputWarning, match="body_mm"),
        pytest.raises(InputError, match="a view that measures some of the part"),
    ):
        plan_views(scene, 1, staging=Staging(count=12, stable_poses=0), counting=strict)


def test_a_table_between_part_and_devices_leaves_no_candidate():
    scene = part_scene(l_block())
    staging = Staging(count=12, stable_poses=1, tilt_deg=90.0)
    low = scene.rig.having(
        camera=scene.rig.camera.posed(Pose.looking_at((0, 300, 600), (0, 0, 0), (0, -1, 0)))
    )
    with pytest.raises(InputError, match="camera below the table"):
        plan_views(replace(scene, rig=low), 1, staging=staging, counting=SMALL)


@pytest.mark.slow
@pytest.mark.parametrize("name", TEN)
def test_ten_parts_are_never_worse_than_a_turntable(name, capsys):
    plan = plan_views(
        scene_with(name),
        6,
        staging=Staging(count=72, stable_poses=3),
        counting=replace(SMALL, samples=6000),
    )
    greedy, solved = plan.patches.coverage(plan.choices[GREEDY]), plan.solution
    with capsys.disabled():
        print(
            f"\n{name}: of patches greedy {100 * greedy:.2f} %, integer programming "
            f"{100 * solved.value:.2f} %, bound {100 * solved.bound:.2f} %, gap of greedy "
            f"{100 * (solved.bound - greedy):.2f} points; {solved.rows} rows, "
            f"{solved.seconds:.1f} s, {solved.status}"
        )
    assert solved.views is not None
    assert INTEGER in plan.choices
    assert solved.seconds < 30.0 + 15.0  # HiGHS looks at its clock between rounds
    assert solved.optimal or "time limit" in solved.status.lower()
    assert max(solved.value, greedy) <= solved.bound + 1e-6
    if solved.optimal:
        assert solved.value >= greedy - 1e-9
    assert greedy >= (1.0 - np.exp(-1.0)) * solved.value
    # Any number of even steps is matched by as many views at the most: of all stable poses, and of
    # the turntable's own pose alone.
    own = [k for k, one in enumerate(plan.candidates) if one.resting == plan.candidates[0].resting]
    turns = uniform_turntables(plan.candidates, 6)
    for columns in (list(range(len(plan.candidates))), own):
        rows = Rows(plan.rows.measured[:, columns], plan.rows.weights)
        patches = Rows(plan.patches.measured[:, columns], plan.patches.weights)
        for count, even in turns.items():
            views = [columns.index(k) for k in even]
            wanted = rows.coverage(views)
            choices, _ = choose(rows, patches, count, wanted, [views], time_limit_s=10.0)
            chosen = choices[best_of(rows, choices, wanted)]
            assert len(chosen) <= count
            assert rows.coverage(chosen) >= wanted - 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "stage", "limit_um", "measurements"),
    [
        ("l-block", "rotary", np.inf, 1),
        ("engine-block", "rotary", np.inf, 1),
        ("engine-block", "robot", 25.0, 1),
        ("engine-block", "rotary", 40.0, 2),
    ],
)
def test_a_scan_covers_what_was_predicted(name, stage, limit_um, measurements):
    scene = scene_with(name, divisor=2)
    counting = Counting(samples=10_000, max_std_mm=1e-3 * limit_um, min_measurements=measurements)
    plan = plan_views(scene, 4, staging=Staging(stage=stage, count=48), counting=counting)
    result = scan_views(scene, plan.viewpoints())
    print(f"{name} {stage}: predicted {plan.coverage:.4f}, scanned {result.coverage:.4f}")
    assert plan.coverage > 0.2
    # 1 % of the surface, as is claimed.
    assert result.coverage == pytest.approx(plan.coverage, abs=0.01)
    # View by view, too, and sample by sample but for a pixel along edges.
    for k, view in enumerate(plan.chosen):
        predicted = plan.rows.measured[:, view]
        with np.errstate(invalid="ignore"):
            measured = result.measured_mm[:, k] <= counting.max_std_mm
        assert np.mean(measured) == pytest.approx(np.mean(predicted), abs=0.01)
