"""The public names of :mod:`slbench.calibration` and where they are defined."""

from .apply import CalibratedCloud as CalibratedCloud
from .apply import measure as measure
from .bundle.alone import calibrate_camera as calibrate_camera
from .bundle.alone import view_picture as view_picture
from .bundle.calibrate import calibrate_boards as calibrate_boards
from .bundle.combine import combine_devices as combine_devices
from .bundle.result import BoardCalibration as BoardCalibration
from .bundle.views import BoardView as BoardView
from .bundle.views import view_board as view_board
from .models.model import CalibrationModel as CalibrationModel
from .models.points import CalibrationPoints as CalibrationPoints
from .selection import Selection as Selection
from .selection import select_models as select_models
from .target.detect import Dots as Dots
from .target.detect import detect_dots as detect_dots
from .target.free import FreeBoard as FreeBoard
from .target.free import find_free_board as find_free_board
from .target.remap import PanelPoints as PanelPoints
from .target.remap import remap as remap
