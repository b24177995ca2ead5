"""The public names of :mod:`slbench.cloud.files` and where they are defined."""

from .measured import MeasuredCloud as MeasuredCloud
from .read import read_cloud as read_cloud
from .write import write_cloud as write_cloud
