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
from slbench.objects.loading import build_artefact, load_artefact, measure
from slbench.objects.registry import ArtefactKind, artefacts

__all__ = [
    "BODY",
    "REFERENCE",
    "Artefact",
    "ArtefactKind",
    "Feature",
    "Mesh",
    "PlaneFeature",
    "SphereFeature",
    "artefacts",
    "build_artefact",
    "load_artefact",
    "measure",
    "surface_height",
]
