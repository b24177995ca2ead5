"""Where a result comes from: the ``provenance.json`` of every output folder."""

import datetime
import importlib.metadata
import platform
from collections.abc import Mapping
from typing import Any

import slbench
from slbench.core.modules import used_modules
from slbench.core.registry import used_packages

#: Distributions whose versions decide a result; recorded in every ``provenance.json``.
PROVENANCE_LIBRARIES = (
    "drjit",
    "manifold3d",
    "mitsuba",
    "moocore",
    "numba",
    "numpy",
    "opencv-python-headless",
    "scikit-image",
    "scikit-learn",
    "scipy",
    "shapely",
    "small_gicp",
    "trimesh",
)


def provenance(parameters: Mapping[str, Any], seed: int | None) -> dict[str, Any]:
    """Return what made a result: version, seed, parameters, libraries, machine, time.

    Versions are read from installed metadata, so nothing heavy is imported.

    Parameters
    ----------
    parameters : mapping
        What the result depends on, as :func:`~slbench.core.io.write_json` takes it.
    seed : int or None
        Seed of the random draws; None where nothing is drawn.

    Returns
    -------
    dict
        Keys ``slbench, seed, parameters, python, libraries, extensions, platform, time_utc``;
        extensions are the packages and modules beside slbench that rows of registries came
        from in this process.
    """
    versions: dict[str, str | None] = {}
    for name in PROVENANCE_LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "slbench": slbench.__version__,
        "seed": seed,
        "parameters": dict(parameters),
        "python": platform.python_version(),
        "libraries": versions,
        "extensions": {"packages": used_packages(), "modules": used_modules()},
        "platform": platform.platform(),
        "time_utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
