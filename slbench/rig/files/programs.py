"""Programs that write OpenCV's matrices by names of their own, in millimetres.

- **SLStudio** (Wilm, Olesen and Larsen 2014), ``CalibrationData::saveXML``: ``Kc kc Kp kp Rp Tp``,
  the sizes of frames and screen; SLScanner's XML has the same with underscores.
- **Brown, Moreno and Taubin** (Moreno and Taubin 2012), ``CalibrationData::save_calibration_yml``:
  ``cam_K cam_kc proj_K proj_kc R T``; sizes are not stored.
- **SLMaster**, ``caliInfo.yml`` of one camera and one projector: ``M1 D1 M4 D4 Rlp Tlp`` and ``S``,
  the camera's size.

Each asks for its board in millimetres, and maps from the camera to the projector.
"""

from slbench.rig.files.matrices import NamedFile

_KEYS = ("K_camera", "dist_camera", "K_projector", "dist_projector", "R", "T")

SLSTUDIO = NamedFile(
    "SLStudio",
    dict(zip(_KEYS, ("Kc", "kc", "Kp", "kp", "Rp", "Tp"), strict=True)),
    {
        "camera": (("frameWidth", "frameHeight"), ("frame_width", "frame_height")),
        "projector": (("screenResX", "screenResY"), ("screen_res_x", "screen_res_y")),
    },
    "mm",
)

MORENO_TAUBIN = NamedFile(
    "Moreno and Taubin's projector-camera calibration",
    dict(zip(_KEYS, ("cam_K", "cam_kc", "proj_K", "proj_kc", "R", "T"), strict=True)),
    {"camera": (("cam_size",),), "projector": (("proj_size",),)},
    "mm",
)

SLMASTER = NamedFile(
    "SLMaster",
    dict(zip(_KEYS, ("M1", "D1", "M4", "D4", "Rlp", "Tlp"), strict=True)),
    {"camera": (("S",),)},
    "mm",
)
