"""The public names of :mod:`slbench.core.io` and where they are defined."""

from .arrays import read_npz as read_npz
from .arrays import read_ply as read_ply
from .arrays import write_npz as write_npz
from .arrays import write_ply as write_ply
from .atomic import atomic_path as atomic_path
from .atomic import check_output_file as check_output_file
from .atomic import check_writable as check_writable
from .folders import OutputFolder as OutputFolder
from .folders import files_beside as files_beside
from .images import read_colour as read_colour
from .images import read_exr as read_exr
from .images import read_grey as read_grey
from .images import write_exr as write_exr
from .images import write_png as write_png
from .opencv_yaml import OtherEntry as OtherEntry
from .opencv_yaml import read_opencv_yaml as read_opencv_yaml
from .opencv_yaml import write_opencv_yaml as write_opencv_yaml
from .provenance import provenance as provenance
from .tables import read_table as read_table
from .tables import write_table as write_table
from .text import plain as plain
from .text import read_json as read_json
from .text import read_toml as read_toml
from .text import write_json as write_json
from .text import write_toml as write_toml
