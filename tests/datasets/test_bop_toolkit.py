"""BOP exports read by the benchmark's own toolkit (``bop_toolkit_lib``, from its repository)."""

import numpy as np
import pytest
from outside_loaders import loader

from slbench.datasets.export.formats import export
from slbench.datasets.read.recipe import Recipe

pytestmark = pytest.mark.filterwarnings("ignore::SyntaxWarning", "ignore::DeprecationWarning")

#: Tolerance of visibility, mm: well above a step of the depth pictures, and below what the ball
#: stands before the block (the toolkit's own 15 mm are for household things).
DELTA = 0.2


@pytest.fixture(scope="module")
def toolkit():
    loader("bop_toolkit_lib")
    from bop_toolkit_lib import inout, misc, visibility
    from bop_toolkit_lib.dataset import bop_scenewise

    return inout, misc, visibility, bop_scenewise


@pytest.fixture(scope="module")
def out(toolkit, data, tmp_path_factory):
    target = tmp_path_factory.mktemp("bop") / "out"
    export(data[:3], target, "bop", Recipe("1,10", seed=3))
    return target


def test_a_scene_is_found_whole(toolkit, out):
    *_, scenewise = toolkit
    found = scenewise.read_scene_infos(out / "train" / "000000", read_image_ids=True)
    assert found["image_ids"] == [0, 1, 2]
    wanted = ("depth", "gray", "mask", "mask_visib", "gt", "gt_info")
    assert all(found[f"has_{name}"] for name in wanted)


def test_depth_masks_and_counts_are_what_the_toolkit_makes_of_models_and_poses(toolkit, out):
    """The steps of its ``calc_gt_info``, with rays through pixels in the place of its OpenGL."""
    inout, misc, visibility, scenewise = toolkit
    place = out / "train" / "000000"
    cameras = inout.load_scene_camera(place / "scene_camera.json")
    poses = inout.load_scene_gt(place / "scene_gt.json")
    stated = inout.load_json(place / "scene_gt_info.json", keys_to_int=True)
    for image, camera in cameras.items():
        depth = inout.load_depth(place / "depth" / f"{image:06d}.png") * camera["depth_scale"]
        matrix = camera["cam_K"]
        seen = misc.depth_im_to_dist_im_fast(depth, matrix)
        masks, visible = (
            scenewise.load_masks(place, image, kind, len(poses[image])) > 0
            for kind in ("mask", "mask_visib")
        )
        for k, pose in enumerate(poses[image]):
            model = inout.load_ply(out / "models" / f"obj_{pose['obj_id']:06d}.ply")
            points = misc.transform_pts_Rt(model["pts"], pose["cam_R_m2c"], pose["cam_t_m2c"])
            own = rendered(points, model["faces"].astype(int), matrix, depth.shape)
            there = misc.depth_im_to_dist_im_fast(own, matrix)
            # Pixels whose middle is on an edge, to single precision of the models.
            edge = 2 + 0.002 * masks[k].sum()
            assert np.count_nonzero((there > 0) != masks[k]) <= edge
            found = visibility.estimate_visib_mask_gt(seen, there, DELTA)
            assert np.count_nonzero(found != visible[k]) <= edge
            info = stated[image][k]
            assert info["px_count_visib"] == pytest.approx(found.sum(), abs=edge)
            assert info["px_count_all"] == pytest.approx((there > 0).sum(), abs=edge)
            rows, columns = found.nonzero()
            box = misc.calc_2d_bbox(columns, rows, depth.shape[::-1])
            np.testing.assert_allclose(info["bbox_visib"], box, atol=1)


def rendered(points, faces, matrix, shape):
    """Return the depth of a model alone at pixel centres, 0 where it is not.

    Rays and triangles by T. Moller and B. Trumbore, Journal of Graphics Tools 2(1), 1997.
    """
    v, u = np.indices(shape)
    rays = np.stack((u, v, np.ones_like(u)), axis=-1).reshape(-1, 3) @ np.linalg.inv(matrix).T
    depth = np.full(len(rays), np.inf)
    for a, b, c in points[faces]:
        one, two = b - a, c - a
        across = np.cross(rays, two)
        scale = across @ one
        with np.errstate(divide="ignore", invalid="ignore"):
            first = across @ -a / scale
            back = np.cross(-a, one)
            second, away = rays @ back / scale, back @ two / scale
            inside = (first >= 0) & (second >= 0) & (first + second <= 1) & (away > 0)
        depth = np.where(inside, np.minimum(depth, away), depth)  # rays have z = 1
    return np.where(np.isfinite(depth), depth, 0.0).reshape(shape)


def test_diameters_are_those_of_the_toolkit(toolkit, out):
    inout, misc, *_ = toolkit
    stated = inout.load_json(out / "models" / "models_info.json", keys_to_int=True)
    for number, entry in stated.items():
        points = inout.load_ply(out / "models" / f"obj_{number:06d}.ply")["pts"]
        # Single precision of the PLY.
        assert entry["diameter"] == pytest.approx(misc.calc_pts_diameter(points), rel=1e-5)
        sizes = [entry[f"size_{axis}"] for axis in "xyz"]
        np.testing.assert_allclose(sizes, np.ptp(points, axis=0), rtol=1e-5)
