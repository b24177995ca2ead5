"""Artefacts with certified dimensions, from parameters or from ``objects/NAME.toml``.

The same parameters give the same mesh, byte for byte.  A TOML file says what kind of
artefact it is, its parameters, its certified dimensions and where they come from::

    kind = "sphere"
    source = "Nominal dimensions"

    [parameters]
    radius_mm = 12.5

    [certified]
    sphere_diameter_mm = 25.0

Loading it measures the mesh and compares it with the certified dimensions.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import read_toml
from slbench.core.validation import Finite, Parameters, shown, validated
from slbench.objects.artefact import (
    BODY,
    REFERENCE,
    Artefact,
    Feature,
    Mesh,
    PlaneFeature,
    SphereFeature,
    measure_features,
    surface_height,
)
from slbench.objects.cache import cached
from slbench.objects.gears.bevel_gear import (
    CurvedGearParameters,
    build_curved_gear,
    measure_curved_gear,
)
from slbench.objects.gears.gear import GearParameters, build_gear, measure_gear
from slbench.objects.gears.helical_gear import (
    HelicalGearParameters,
    build_helical_gear,
    measure_helical_gear,
)
from slbench.objects.gears.watch_gear import (
    WatchGearParameters,
    build_watch_gear,
    measure_watch_gear,
)
from slbench.objects.mesh.file import MeshParameters, build_mesh_file
from slbench.objects.parts.brick import BrickParameters, build_brick, measure_brick
from slbench.objects.parts.coin import CoinParameters, build_coin, measure_coin
from slbench.objects.parts.engine_block import (
    EngineBlockParameters,
    build_engine_block,
    measure_engine_block,
)
from slbench.objects.parts.propeller import (
    PropellerParameters,
    build_propeller,
    measure_propeller,
)
from slbench.objects.shapes.ball_bar import BallBarParameters, build_ball_bar, measure_ball_bar
from slbench.objects.shapes.microlens import (
    MicroLensParameters,
    build_micro_lens,
    measure_micro_lens,
)
from slbench.objects.shapes.plane import PlaneParameters, build_plane
from slbench.objects.shapes.pyramid_array import (
    PyramidArrayParameters,
    build_pyramid_array,
    measure_pyramid_array,
)
from slbench.objects.shapes.sinusoid import SinusoidParameters, build_sinusoid, measure_sinusoid
from slbench.objects.shapes.sphere import SphereParameters, build_sphere
from slbench.objects.shapes.stepblock import StepBlockParameters, build_step_block
from slbench.objects.targets.calibration_grid import (
    CalibrationGridParameters,
    build_calibration_grid,
    measure_calibration_grid,
)
from slbench.objects.targets.chequerboard import (
    ChequerboardParameters,
    build_chequerboard,
    measure_chequerboard,
)
from slbench.objects.targets.circle_grid import (
    CircleGridParameters,
    build_circle_grid,
    measure_circle_grid,
)

__all__ = [
    "BODY",
    "KINDS",
    "REFERENCE",
    "Artefact",
    "Feature",
    "Mesh",
    "PlaneFeature",
    "SphereFeature",
    "build",
    "load",
    "measure",
    "surface_height",
]


class ArtefactKind(NamedTuple):
    """A kind of artefact: the model of its parameters, its builder, and how to measure it.

    ``measure`` gives the dimensions that only this kind has, from the mesh alone: the
    artefact's parameters may say *where* to measure (at which circle, over how many teeth),
    never what comes out.
    """

    parameters: type[Parameters]
    build: Callable[[Any, str, str], Artefact]
    measure: Callable[[Artefact], dict[str, float]] | None = None


#: What :func:`build` can build.
KINDS: dict[str, ArtefactKind] = {
    "plane": ArtefactKind(PlaneParameters, build_plane),
    "sphere": ArtefactKind(SphereParameters, build_sphere),
    "step_block": ArtefactKind(StepBlockParameters, build_step_block),
    "mesh": ArtefactKind(MeshParameters, build_mesh_file),
    "calibration_grid": ArtefactKind(
        CalibrationGridParameters, build_calibration_grid, measure_calibration_grid
    ),
    "chequerboard": ArtefactKind(ChequerboardParameters, build_chequerboard, measure_chequerboard),
    "circle_grid": ArtefactKind(CircleGridParameters, build_circle_grid, measure_circle_grid),
    "coin": ArtefactKind(CoinParameters, build_coin, measure_coin),
    "micro_lens": ArtefactKind(MicroLensParameters, build_micro_lens, measure_micro_lens),
    "pyramid_array": ArtefactKind(
        PyramidArrayParameters, build_pyramid_array, measure_pyramid_array
    ),
    "sinusoid": ArtefactKind(SinusoidParameters, build_sinusoid, measure_sinusoid),
    "propeller": ArtefactKind(PropellerParameters, build_propeller, measure_propeller),
    "brick": ArtefactKind(BrickParameters, build_brick, measure_brick),
    "engine_block": ArtefactKind(EngineBlockParameters, build_engine_block, measure_engine_block),
    "ball_bar": ArtefactKind(BallBarParameters, build_ball_bar, measure_ball_bar),
    "gear": ArtefactKind(GearParameters, build_gear, measure_gear),
    "curved_gear": ArtefactKind(CurvedGearParameters, build_curved_gear, measure_curved_gear),
    "watch_gear": ArtefactKind(WatchGearParameters, build_watch_gear, measure_watch_gear),
    "double_helical_gear": ArtefactKind(
        HelicalGearParameters, build_helical_gear, measure_helical_gear
    ),
}


class _ArtefactFile(Parameters):
    kind: str
    source: str
    parameters: dict[str, Any] = Field(default_factory=dict)
    certified: dict[str, Finite] = Field(default_factory=dict)


def build(
    kind: str,
    parameters: object,
    where: str = "parameters",
    *,
    name: str | None = None,
    folder: str | Path | None = None,
) -> Artefact:
    """Build an artefact from its parameters.

    Parameters
    ----------
    kind : str
        A key of :data:`KINDS`.
    parameters : mapping
        As in the ``[parameters]`` of a TOML; see the kind's module.
    where : str
        Where they were read, for error messages.
    name : str, optional
        What to call it; the kind if not given.
    folder : str or Path, optional
        The folder of the file that the parameters were read from: a path among them is
        relative to it and must stay inside.  Without it a path is taken as it is.

    Returns
    -------
    Artefact
        Mesh, features and nominal dimensions.

    Raises
    ------
    InputError
        If the kind or a key is unknown, or a value cannot be used.
    """
    return _built(kind, parameters, where, name, folder)[0]


def _built(
    kind: str, parameters: object, where: str, name: str | None, folder: str | Path | None
) -> tuple[Artefact, dict[str, float]]:
    """Build and measure an artefact, or take both from the cache."""
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError("kind", f"one of {', '.join(KINDS)}", shown(kind))
    checked = validated(KINDS[kind].parameters, parameters, where)

    def make() -> tuple[Artefact, dict[str, float]]:
        artefact = KINDS[kind].build(checked, name or kind, where)
        return artefact, measure(artefact)

    if isinstance(checked, MeshParameters):  # the file may change, and reading it is quick
        if folder is not None:
            path = resources.inside(folder, checked.path)
            checked = checked.model_copy(update={"path": str(path)})
        return make()
    values = checked.model_dump()
    artefact, measured = cached(kind, values, make)
    return dataclasses.replace(artefact, name=name or kind, parameters=values), measured


def measure(artefact: Artefact) -> dict[str, float]:
    """Measure an artefact's dimensions back from its mesh.

    Parameters
    ----------
    artefact : Artefact
        The artefact.

    Returns
    -------
    dict of str to float
        What :func:`~slbench.objects.artefact.measure_features` finds, and the dimensions
        that its kind measures besides (:class:`ArtefactKind`).
    """
    measured = measure_features(artefact)
    kind = KINDS.get(artefact.kind)
    if kind is not None and kind.measure is not None:
        measured |= kind.measure(artefact)
    return measured


def load(name_or_path: str | Path) -> Artefact:
    """Load an artefact from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A file, or the name of a shipped one, e.g. ``"step-block-5"``.

    Returns
    -------
    Artefact
        With the certified dimensions of the file, and its source.

    Raises
    ------
    InputError
        If the file cannot be used, or certifies what its mesh does not have.
    """
    path = resources.find("objects", name_or_path)
    file = validated(_ArtefactFile, read_toml(path), path.name, separator=": ")
    if file.kind not in KINDS:
        raise InputError(f"{path.name}: kind", f"one of {', '.join(KINDS)}", shown(file.kind))
    where = f"{path.name}: parameters"
    artefact, measured = _built(file.kind, file.parameters, where, path.stem, path.parent)
    for key, value in file.certified.items():
        where = f"{path.name}: certified.{key}"
        if key not in artefact.certified:
            known = ", ".join(artefact.certified)
            raise InputError(where, f"one of the dimensions {known}", "another")
        # A nanometre, and the rounding of a mesh file in single precision.
        if not abs(value - measured[key]) <= 1e-6 + 1e-6 * abs(value):
            raise InputError(where, f"{measured[key]:.9g} as the mesh has it", f"{value:.9g}")
    return dataclasses.replace(
        artefact, source=file.source, certified={**artefact.certified, **file.certified}
    )
