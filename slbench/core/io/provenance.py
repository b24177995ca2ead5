"""Where a result comes from: the ``provenance.json`` of every output folder."""

import datetime
import functools
import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Mapping
from pathlib import Path
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
    """Return what made a result: version, commit, seed, parameters, libraries, machine, time.

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
        Keys ``slbench, commit, seed, parameters, python, libraries, extensions, platform,
        time_utc``; the commit is that of the package's git checkout, with ``-dirty`` behind it
        where files differ from it, and None where there is no checkout; extensions are the
        packages and modules beside slbench that rows of registries came from in this process.
    """
    versions: dict[str, str | None] = {}
    for name in PROVENANCE_LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "slbench": slbench.__version__,
        "commit": _commit(Path(slbench.__file__).parents[1]),
        "seed": seed,
        "parameters": dict(parameters),
        "python": platform.python_version(),
        "libraries": versions,
        "extensions": {"packages": used_packages(), "modules": used_modules()},
        "platform": platform.platform(),
        "time_utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


@functools.cache
def _commit(checkout: Path) -> str | None:
    """Return the commit of a git checkout; None where the folder is none, or git cannot tell."""
    if not (checkout / ".git").exists():
        return None
    command = "git --no-optional-locks describe --always --dirty --abbrev=40 --exclude=*"
    # Hooks of git name the repository that they run for, which is another.
    others = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    options: dict[str, Any] = {"capture_output": True, "text": True, "check": True, "timeout": 10.0}
    try:
        found = subprocess.run(command.split(), cwd=checkout, env=others, **options)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()
