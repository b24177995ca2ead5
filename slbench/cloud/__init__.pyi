"""The public names of :mod:`slbench.cloud` and where they are defined."""

from . import files as files
from . import fits as fits
from . import registration as registration
from .blocks import match_blocks as match_blocks
from .decoded import Decoded as Decoded
from .decoded import decode_capture as decode_capture
from .files.measured import MeasuredCloud as MeasuredCloud
from .files.read import read_cloud as read_cloud
from .files.write import write_cloud as write_cloud
from .joint import JointCloud as JointCloud
from .joint import triangulate_jointly as triangulate_jointly
from .registration.graph import Registration as Registration
from .registration.graph import register_views as register_views
from .stereo import triangulate_stereo as triangulate_stereo
from .together import DecodedRig as DecodedRig
from .together import decode_captures as decode_captures
from .triangulation import PointCloud as PointCloud
from .triangulation import triangulate as triangulate
