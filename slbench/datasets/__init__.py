"""Data sets: many scans of drawn scenes, packed in shards with an index.

A data set stores the light transport of every sample, so that whoever uses it can put any
pattern set, response, exposure and noise on it afterwards.  Making one needs Mitsuba and the
extra ``datasets``; :mod:`slbench.datasets.spec.specification` says what is drawn, ``engine`` makes
it on a Dask cluster.  Using one needs no Mitsuba: :func:`open_dataset` reads it,
``torch_adaptor`` feeds it to PyTorch, ``export`` writes other layouts.
"""

from slbench.datasets.read.reader import Dataset, open_dataset
from slbench.datasets.read.stored import Sample

__all__ = ["Dataset", "Sample", "open_dataset"]
