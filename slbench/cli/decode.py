"""``slbench decode``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slbench.cli.common import (
    AllowModules,
    AllowOutside,
    Gamma,
    Json,
    MinModulation,
    ResponseFile,
    print_json,
    read_response,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError, located
from slbench.core.validation.types import Measure, OrderResidual

if TYPE_CHECKING:
    from slbench.cloud.decoded import Decoded
    from slbench.cloud.together import DecodedRig
    from slbench.patterns import Response
    from slbench.rig.motion import Motion


@command("slbench decode out/step-block --out decoded")
def decode(
    folder: Annotated[
        Path, typer.Argument(help="A folder of frames with a capture.toml beside them.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: FOLDER/decoded]")
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig to triangulate with: rig.yaml.")] = None,
    min_modulation: MinModulation = None,
    max_order_residual: Annotated[
        OrderResidual | None,
        typer.Option(
            help="Largest residual of a fringe order that is believed, turns.  "
            "[default: the capture's]"
        ),
    ] = None,
    page: Annotated[
        Path | None, typer.Option("--report", help="Report to write too: one HTML page (.html).")
    ] = None,
    picture: Annotated[
        bool, typer.Option("--picture/--no-picture", help="Draw summary.png.")
    ] = True,
    decoder: Annotated[
        str | None,
        typer.Option(help="Decoder of your own, mine.py:decode; with --allow-modules."),
    ] = None,
    meeting: Annotated[
        Literal["ray", "nearest"],
        typer.Option(
            help="Point of two coded axes: on the camera's ray, or nearest to both rays (thesis)."
        ),
    ] = "ray",
    stereo: Annotated[
        Literal["phase", "blocks"] | None,
        typer.Option(
            help="Match two cameras, by equal codes or by blocks of grey values; the projector "
            "need not be calibrated."
        ),
    ] = None,
    cameras: Annotated[
        str | None, typer.Option(help="Of several cameras those that are used: left,right.")
    ] = None,
    projectors: Annotated[
        str | None, typer.Option(help="Of several projectors those that are used.")
    ] = None,
    near: Annotated[
        Measure | None, typer.Option(help="Least depth that blocks are searched at, mm.")
    ] = None,
    far: Annotated[
        Measure | None, typer.Option(help="Largest depth that blocks are searched at, mm.")
    ] = None,
    velocity: Annotated[
        str | None,
        typer.Option(
            help="Velocity of what was seen, mm/s, to be taken out: 0,0,20, or estimated.  The "
            "capture.toml has frame_period_ms."
        ),
    ] = None,
    rotation: Annotated[
        str | None, typer.Option(help="Its angular velocity besides, deg/s: 0,0,90.")
    ] = None,
    rotation_centre: Annotated[
        str | None, typer.Option(help="A point of the axis, mm.  [default: 0,0,0]")
    ] = None,
    gamma: Gamma = None,
    response: ResponseFile = None,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Decode frames from disk; triangulate where a rig is known.

    The frames may be simulated or photographed.  Those of several cameras and projectors make one
    cloud.
    """
    from slbench.capture.capture import Capture
    from slbench.capture.captures import holds_pairs
    from slbench.cloud.decoded import DECODED_FOLDER, decode_capture
    from slbench.rig.opencv import read_rig

    target = out or (folder if folder.is_dir() else folder.parent) / "decoded"
    several: dict[str, Any] = {"stereo": stereo, "cameras": cameras, "projectors": projectors}
    several |= {"near": near, "far": far}
    motion = _motion(velocity, rotation, rotation_centre)
    if holds_pairs(folder):
        if motion is not None:
            expected = "none with several cameras and projectors: decode them pair by pair"
            raise InputError("--velocity", expected, velocity or rotation)
        if meeting != "ray":
            raise InputError("--meeting", "ray, as several devices are triangulated", meeting)
        limits = {"min_modulation": min_modulation, "max_order_residual": max_order_residual}
        allowed = {"allow_modules": allow_modules, "allow_outside": allow_outside}
        made = _decoded_together(
            folder,
            rig,
            several,
            limits,
            decoder,
            read_response(gamma, response),
            allowed,
            (target, page),
        )
        _write_together(made, target, {"folder": str(folder)} | several, page, picture, as_json)
        return
    for name, value in several.items():
        if value is not None:
            expected = "a capture.toml with [[pairs]] of several cameras beside it"
            raise InputError(f"--{name}", expected, str(folder))
    DECODED_FOLDER.check(target, "--out")
    shots = Capture.load(folder, allow_modules=allow_modules, allow_outside=allow_outside)
    if rig is not None:
        known = read_rig(rig, shots.pair)
        shots = replace(shots, rig=known if len(known.pairs) == 1 else known.pair(shots.pair))
    straight = read_response(gamma, response)
    if straight is not None:
        shots = replace(shots, response=straight)
    if page is not None:
        from slbench.report.page import check_page_path

        check_page_path(page)
    own = None
    if decoder is not None:
        from slbench.patterns import read_decoder

        limits = {"--min-modulation": min_modulation, "--max-order-residual": max_order_residual}
        for name, limit in limits.items():
            if limit is not None:
                raise InputError(name, "none with --decoder, which has its own limits", limit)
        own = read_decoder(decoder, None, allow_modules, "--decoder")
    decoded = decode_capture(
        shots,
        min_modulation=min_modulation,
        max_order_residual=max_order_residual,
        decoder=own,
        meeting=meeting,
        motion=motion,
        where=folder,
    )
    parameters = {"folder": str(folder), "rig": str(rig) if rig else None, "decoder": decoder}
    parameters |= {"meeting": meeting}
    if shots.response is not None:
        parameters |= {"response": str(shots.response)}
    if motion is not None:
        parameters |= {"motion": decoded.motion}
    files = {}
    if picture:
        from slbench.report.plots.decoded import write_decoded_picture

        files["summary.png"] = partial(write_decoded_picture, decoded)
    decoded.save(target, parameters, files)
    if page is not None:
        from slbench.report.page import write_page
        from slbench.report.pages.decoded import decoded_page

        write_page(decoded_page(decoded, parameters), page)
    _print(decoded, target, page, files, as_json)


def _decoded_together(
    folder: Path,
    rig: Path | None,
    several: Mapping[str, Any],
    limits: Mapping[str, float | None],
    decoder: str | None,
    straight: Response | None,
    allowed: Mapping[str, bool],
    outputs: tuple[Path, Path | None],
) -> DecodedRig:
    """Decode the captures of several pairs, for a folder and perhaps a page."""
    from slbench.capture.captures import Captures
    from slbench.cloud.together import decode_captures, folder_for
    from slbench.patterns import read_decoder
    from slbench.rig.opencv import read_rig

    shots = Captures.load(folder, **allowed)
    if rig is not None:
        shots = shots.with_rig(read_rig(rig))
    chosen = {name: several[name] for name in ("cameras", "projectors")}
    for name, text in chosen.items():
        with located(f"--{name}"):
            names = None if text is None else [one.strip() for one in text.split(",")]
            shots = shots.of(**{name: names})
    target, page = outputs
    folder_for(shots).check(target, "--out")
    if page is not None:
        from slbench.report.page import check_page_path

        check_page_path(page)
    if straight is not None:
        own = {pair: replace(one, response=straight) for pair, one in shots.captures.items()}
        shots = Captures(own, shots.rig)
    depth = (several["near"], several["far"])
    if (depth[0] is None) != (depth[1] is None):
        raise InputError("--near, --far", "both or neither", "one of them")
    if decoder is not None:
        for name, limit in limits.items():
            if limit is not None:
                option = f"--{name.replace('_', '-')}"
                raise InputError(option, "none with --decoder, which has its own limits", limit)
    return decode_captures(
        shots,
        stereo=several["stereo"],
        decoder=None
        if decoder is None
        else read_decoder(decoder, None, allowed["allow_modules"], "--decoder"),
        depth_mm=None if depth[0] is None else depth,
        where=folder,
        **limits,
    )


def _write_together(
    decoded: DecodedRig,
    target: Path,
    parameters: Mapping[str, Any],
    page: Path | None,
    picture: bool,
    as_json: bool,
) -> None:
    """Write what several pairs were decoded to, and print it."""
    files = {}
    if picture and decoded.cloud is not None:
        from slbench.core.show.drawing import write_figure

        files["summary.png"] = partial(write_figure, decoded.cloud)
    decoded.save(target, parameters, files)
    if page is not None:
        from slbench.report.page import write_page
        from slbench.report.pages.decoded import decoded_rig_page

        write_page(decoded_rig_page(decoded, parameters), page)
    _print(decoded, target, page, files, as_json)


def _print(
    decoded: Decoded | DecodedRig,
    target: Path,
    page: Path | None,
    files: Mapping[str, Any],
    as_json: bool,
) -> None:
    """Print what was found and where it was written."""
    if as_json:
        written = {"out": str(target)} | ({} if page is None else {"report": str(page)})
        print_json(decoded.to_dict() | written)
        return
    for name, value in decoded.rows():
        print(f"{name}: {value}")
    shown = page or (target / "summary.png" if files else None)
    print(f"Written to {target}" + (f": open {shown}" if shown else ""))


def _motion(
    velocity: str | None, rotation: str | None, centre: str | None
) -> Motion | Literal["estimated"] | None:
    """Return the motion that options state."""
    from slbench.rig.motion import Motion

    if centre is not None and rotation is None:
        raise InputError("--rotation-centre", "--rotation beside it", centre)
    if velocity == "estimated":
        if rotation is not None:
            raise InputError("--rotation", "none beside --velocity estimated", rotation)
        return "estimated"
    if velocity is None and rotation is None:
        return None
    still = (0.0, 0.0, 0.0)
    return Motion(
        velocity_mm_per_s=still if velocity is None else _vector(velocity, "--velocity"),
        rotation_deg_per_s=still if rotation is None else _vector(rotation, "--rotation"),
        centre_mm=None if centre is None else _vector(centre, "--rotation-centre"),
    )


def _vector(text: str, option: str) -> tuple[float, float, float]:
    """Return three numbers with commas between."""
    more = " or estimated" if option == "--velocity" else ""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        expected = f"three numbers such as 0,0,20{more}"
        raise InputError(option, expected, repr(text)) from None
    if not all(abs(one) <= 1e6 for one in (x, y, z)):
        raise InputError(option, "numbers from -1e6 to 1e6", repr(text))
    return x, y, z
