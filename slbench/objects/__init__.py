"""Artefacts with certified dimensions, from parameters or from ``objects/NAME.toml``."""

from slbench.objects.artefact import (
    BODY,
    REFERENCE,
    Artefact,
    Feature,
    Mesh,
    PlaneFeature,
    SphereFeature,
    surface_height,
)
from slbench.objects.declared.dimensions import Dimension
from slbench.objects.declared.surface import SurfaceFeature
from slbench.objects.loading import build_artefact, load_artefact, measure
from slbench.objects.registry import ArtefactKind, artefacts

__all__ = [
    "BODY",
    "REFERENCE",
    "Artefact",
    "ArtefactKind",
    "Dimension",
    "Feature",
    "Mesh",
    "PlaneFeature",
    "SphereFeature",
    "SurfaceFeature",
    "artefacts",
    "build_artefact",
    "load_artefact",
    "measure",
    "surface_height",
]
