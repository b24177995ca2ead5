"""The kinds of artefact that there are, by name.

To add one, write a module with its parameters, its builder and a ``KIND``, and name it here;
outside slbench the entry-point group ``slbench.artefacts``, or :meth:`Registry.add` in a module
that a scene names.  No builder is imported before it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.registry import Registry
from slbench.core.validation.tables import Parameters
from slbench.objects.artefact import Artefact


@dataclass(frozen=True)
class ArtefactKind:
    """A kind of artefact: the model of its parameters, its builder, and how to measure it.

    Parameters
    ----------
    parameters : type
        Model of the keys of ``[parameters]``.
    build : callable
        ``build(parameters, name, where)`` returns the Artefact; `where` is for messages.
    measure : callable, optional
        ``measure(artefact)`` gives the dimensions that only this kind has, by name, from the
        mesh alone: the artefact's parameters may say *where* to measure (at which circle, over
        how many teeth), never what comes out.
    files : tuple of str
        Names of the parameters that are paths of files, relative to the file that they are
        written in.
    groups : callable, optional
        ``groups(artefact)`` gives the faces of the mesh that have a name, by which features may be
        declared; its parts if not given.
    """

    parameters: type[Parameters]
    build: Callable[[Any, str, str], Artefact]
    measure: Callable[[Artefact], dict[str, float]] | None = None
    files: tuple[str, ...] = ()
    groups: Callable[[Artefact], Mapping[str, NDArray[np.int64]]] | None = None


artefacts: Registry[ArtefactKind] = Registry(
    "kind",
    "slbench.artefacts",
    {
        "plane": "slbench.objects.shapes.plane:KIND",
        "sphere": "slbench.objects.shapes.sphere:KIND",
        "step_block": "slbench.objects.shapes.stepblock:KIND",
        "mesh": "slbench.objects.mesh.file:KIND",
        "calibration_grid": "slbench.objects.targets.calibration_grid:KIND",
        "chequerboard": "slbench.objects.targets.chequerboard:KIND",
        "charuco": "slbench.objects.targets.charuco:KIND",
        "circle_grid": "slbench.objects.targets.circle_grid:KIND",
        "coin": "slbench.objects.parts.coin:KIND",
        "micro_lens": "slbench.objects.shapes.microlens:KIND",
        "bowl": "slbench.objects.shapes.bowl:KIND",
        "pyramid_array": "slbench.objects.shapes.pyramid_array:KIND",
        "siemens_star": "slbench.objects.shapes.siemens_star:KIND",
        "sinusoid": "slbench.objects.shapes.sinusoid:KIND",
        "propeller": "slbench.objects.parts.propeller:KIND",
        "feature_plate": "slbench.objects.parts.feature_plate:KIND",
        "brick": "slbench.objects.parts.brick:KIND",
        "engine_block": "slbench.objects.parts.engine_block:KIND",
        "ball_bar": "slbench.objects.shapes.ball_bar:KIND",
        "gear": "slbench.objects.gears.gear:KIND",
        "curved_gear": "slbench.objects.gears.bevel_gear:KIND",
        "watch_gear": "slbench.objects.gears.watch_gear:KIND",
        "double_helical_gear": "slbench.objects.gears.helical_gear:KIND",
    },
    base="slbench.objects.registry:ArtefactKind",
)
