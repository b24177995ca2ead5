"""Building artefacts from parameters, and loading them from ``objects/NAME.toml``.

The same parameters give the same mesh, byte for byte.  A TOML file says what kind of
artefact it is, its parameters, its certified dimensions and where they come from::

    kind = "sphere"
    source = "Nominal dimensions"

    [parameters]
    radius_mm = 12.5

    [certified]
    sphere_diameter_mm = 25.0

Loading it measures the mesh and compares it with the certified dimensions.  Tables ``[[features]]``
and ``[[dimensions]]`` declare what is to be measured on the mesh besides
(:mod:`slbench.objects.declared`).
"""

import dataclasses
from pathlib import Path
from typing import Any

from pydantic import Field

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import read_toml
from slbench.core.registry import OWN, quoted
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Finite
from slbench.core.validation.values import validated
from slbench.objects.artefact import Artefact, measure_features
from slbench.objects.cache import cached
from slbench.objects.declared.certify import declare_dimensions
from slbench.objects.declared.declare import declare_features
from slbench.objects.declared.tables import DimensionTable, FeatureTable
from slbench.objects.registry import artefacts


class ArtefactFile(Parameters):
    """The tables of an artefact's file."""

    kind: str
    source: str
    parameters: dict[str, Any] = Field(default_factory=dict)
    certified: dict[str, Finite] = Field(default_factory=dict)
    features: tuple[FeatureTable, ...] = ()
    dimensions: tuple[DimensionTable, ...] = ()


def build_artefact(
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
        A name of :data:`slbench.objects.registry.artefacts`.
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
    row = artefacts.get(kind, "kind")
    checked = validated(row.parameters, parameters, where)

    def make() -> tuple[Artefact, dict[str, float]]:
        artefact = row.build(checked, name or kind, where)
        return artefact, measure(artefact)

    if folder is not None:
        paths = {key: getattr(checked, key) for key in row.files}
        inside = {key: str(resources.inside(folder, path)) for key, path in paths.items()}
        checked = checked.model_copy(update=inside)
    # A file may change, and so may what is not slbench's: neither is in the key of the cache.
    if row.files or artefacts.origin(kind) != OWN:
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
        that its kind measures besides (:class:`~slbench.objects.registry.ArtefactKind`).
    """
    measured = measure_features(artefact)
    if artefact.kind in artefacts:
        own = artefacts.get(artefact.kind).measure
        if own is not None:
            measured |= own(artefact)
    return measured


def read_artefact_file(path: Path) -> ArtefactFile:
    """Read the tables of an artefact's file, and check them.

    Raises
    ------
    InputError
        If the file cannot be used, or its kind is none.
    """
    file = validated(ArtefactFile, read_toml(path), path.name, separator=": ")
    artefacts.get(file.kind, f"{path.name}: kind")
    return file


def load_artefact(name_or_path: str | Path) -> Artefact:
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
        If the file cannot be used, certifies what its mesh does not have, or declares a feature
        that is not there.

    Warns
    -----
    InputWarning
        Where the mesh does not have a declared dimension within its tolerance.
    """
    path = resources.find("objects", name_or_path)
    file = read_artefact_file(path)
    where = f"{path.name}: parameters"
    artefact, measured = _built(file.kind, file.parameters, where, path.stem, path.parent)
    for key, value in file.certified.items():
        where = f"{path.name}: certified.{key}"
        if key not in artefact.certified:
            known = list(artefact.certified)
            expected = f"one of the dimensions {', '.join(known)}"
            raise InputError(f"{path.name}: certified", expected, quoted(key, known))
        # A nanometre, and the rounding of a mesh file in single precision.
        if not abs(value - measured[key]) <= 1e-6 + 1e-6 * abs(value):
            raise InputError(where, f"{measured[key]:.9g} as the mesh has it", f"{value:.9g}")
    artefact = dataclasses.replace(
        artefact, source=file.source, certified={**artefact.certified, **file.certified}
    )
    return _declared(artefact, file, path.name)


def _declared(artefact: Artefact, file: ArtefactFile, where: str) -> Artefact:
    """Return an artefact with the features and dimensions that its file declares."""
    if not file.features and not file.dimensions:
        return artefact
    groups = artefacts.get(artefact.kind).groups
    declared = declare_features(
        file.features,
        artefact.mesh,
        lambda: artefact.parts if groups is None else groups(artefact),
        [feature.name for feature in artefact.features],
        where,
    )
    artefact = dataclasses.replace(artefact, declared=declared)
    elements = {surface.name: surface.element for surface in artefact.measurable}
    dimensions = declare_dimensions(file.dimensions, elements, where)
    return dataclasses.replace(artefact, dimensions=dimensions)
