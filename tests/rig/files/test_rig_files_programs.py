"""Files of programs that name OpenCV's matrices in their own way."""

import numpy as np
import pytest
from calibrations import (
    DIST_CAMERA,
    DIST_PROJECTOR,
    K_CAMERA,
    K_PROJECTOR,
    SIZE_CAMERA,
    SIZE_PROJECTOR,
    R,
    T,
    assert_projects,
    storage,
)

from slbench.core.errors import InputError
from slbench.rig.files.entries import Stated, rig_entries
from slbench.rig.opencv import read_rig

BOTH = Stated(sizes_px={"camera": SIZE_CAMERA, "projector": SIZE_PROJECTOR})


@pytest.mark.parametrize("underscores", [False, True], ids=["SLStudio", "SLScanner"])
def test_slstudio_says_all(underscores, tmp_path):
    sizes = {"frameWidth": 1280, "frameHeight": 1024, "screenResX": 1280, "screenResY": 800}
    if underscores:
        names = ("frame_width", "frame_height", "screen_res_x", "screen_res_y")
        sizes = dict(zip(names, sizes.values(), strict=True))
    path = storage(
        tmp_path / "calibration.xml",
        **{"Kc": K_CAMERA, "kc": DIST_CAMERA, "Kp": K_PROJECTOR, "kp": DIST_PROJECTOR},
        **{"Rp": R, "Tp": T, "cam_error": 0.2, "stereo_error": 0.3},
        **sizes,
    )
    assert_projects(read_rig(path))
    assert rig_entries(path).format == "slstudio"


def test_sizes_that_slstudio_did_not_know_are_asked_for(tmp_path):
    path = storage(
        tmp_path / "c.xml",
        **{"Kc": K_CAMERA, "kc": DIST_CAMERA, "Kp": K_PROJECTOR, "kp": DIST_PROJECTOR},
        **{"Rp": R, "Tp": T, "frameWidth": 1280, "frameHeight": 1024},
        **{"screenResX": 0, "screenResY": 0},
    )
    with pytest.raises(InputError, match="--size-projector") as caught:
        read_rig(path)
    assert "--size-camera" not in str(caught.value)
    assert_projects(read_rig(path, stated=BOTH))


def test_moreno_and_taubin(tmp_path):
    path = storage(
        tmp_path / "calibration.yml",
        **{"cam_K": K_CAMERA, "cam_kc": DIST_CAMERA, "proj_K": K_PROJECTOR},
        **{"proj_kc": DIST_PROJECTOR, "R": R, "T": T, "cam_error": 0.1, "proj_error": 0.2},
    )
    assert_projects(read_rig(path, stated=BOTH))
    assert rig_entries(path, BOTH).format == "moreno-taubin"


def test_slmaster(tmp_path):
    path = storage(
        tmp_path / "caliInfo.yml",
        **{"M1": K_CAMERA, "D1": DIST_CAMERA, "S": np.array(SIZE_CAMERA, dtype=np.float64)},
        **{"M4": K_PROJECTOR, "D4": DIST_PROJECTOR, "Rlp": R, "Tlp": T},
    )
    stated = Stated(sizes_px={"projector": SIZE_PROJECTOR})
    assert_projects(read_rig(path, stated=stated))
    assert rig_entries(path, stated).format == "slmaster"


def test_a_missing_entry_is_named(tmp_path):
    path = storage(tmp_path / "c.yml", cam_K=K_CAMERA, cam_kc=DIST_CAMERA, proj_K=K_PROJECTOR, R=R)
    with pytest.raises(InputError, match=r"c\.yml: proj_kc: expected this entry, got nothing"):
        read_rig(path, stated=BOTH)
