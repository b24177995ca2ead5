import trimesh

from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Length
from slbench.objects import Artefact, ArtefactKind, Mesh


class BoxParameters(Parameters):
    """A box on the plane z = 0."""

    size_mm: tuple[Length, Length, Length]


def build_box(parameters, name, where):
    height = parameters.size_mm[2]
    solid = trimesh.creation.box(parameters.size_mm)
    solid.apply_translation([0.0, 0.0, height / 2.0])
    return Artefact(
        name=name,
        kind="box",
        parameters=parameters.model_dump(),
        mesh=Mesh(solid.vertices, solid.faces),
        certified={"size_z_mm": height},
    )


BOX = ArtefactKind(BoxParameters, build_box)
