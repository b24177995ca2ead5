"""The public names of :mod:`slbench.scene` and where they are defined."""

from .colour import Colour as Colour
from .environment import Environment as Environment
from .environment import environment_of as environment_of
from .file import load_scene as load_scene
from .frame_errors import BitPlanes as BitPlanes
from .frame_errors import Drift as Drift
from .frame_errors import Trigger as Trigger
from .model import Exposure as Exposure
from .model import Light as Light
from .model import Scene as Scene
from .model import SceneObject as SceneObject
from .surfaces.materials import Material as Material
from .truth import GroundTruth as GroundTruth
from .truth import Status as Status
