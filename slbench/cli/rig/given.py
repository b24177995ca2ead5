"""Options of commands that read a rig's file: what a file of another program does not say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slbench.cli.common import size_of
from slbench.core.units import Unit
from slbench.core.validation.types import Interval, Positive

if TYPE_CHECKING:
    from slbench.rig.files.entries import Stated

RigUnit = Annotated[
    Unit | None,
    typer.Option(help="Unit of the translation, where the file does not say."),
]
Order = Annotated[
    Literal["camera-projector", "projector-camera", "camera-camera"] | None,
    typer.Option(help="The file's first and second device, where names do not tell."),
]
SizeCamera = Annotated[
    str | None, typer.Option(metavar="<WxH>", help="Pixels of the camera, where the file has none.")
]
SizeProjector = Annotated[
    str | None,
    typer.Option(metavar="<WxH>", help="Pixels of the projector's panel: 1280x800."),
]
PitchCamera = Annotated[
    Positive | None, typer.Option(help="Pixel pitch of the camera, um.", show_default=False)
]
PitchProjector = Annotated[
    Positive | None, typer.Option(help="Pixel pitch of the panel, um.", show_default=False)
]
FirstPixel = Annotated[
    Annotated[int, Interval(ge=0, le=1)] | None,
    typer.Option(
        help="Coordinates of the centre of the top left pixel, where not the format's own."
    ),
]


def stated_of(
    unit: str | None,
    order: Literal["camera-projector", "projector-camera", "camera-camera"] | None,
    sizes: dict[str, str | None],
    pitches_um: dict[str, float | None],
    first_pixel: int | None,
) -> Stated:
    """Return what the options state of a file; sizes and pitches by device."""
    from slbench.rig.files.entries import Stated

    return Stated(
        unit=unit,
        order=order,
        sizes_px={
            role: size_of(text, f"--size-{role}")
            for role, text in sizes.items()
            if text is not None
        },
        pitches_um={role: pitch for role, pitch in pitches_um.items() if pitch is not None},
        first_pixel=first_pixel,
    )
