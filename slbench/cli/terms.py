"""``slbench terms``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slbench.cli.common import (
    Align,
    AllowModules,
    Json,
    MeasuredWith,
    Preview,
    SceneChanges,
    Seed,
    load_changed,
    print_json,
    print_table,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.units import Unit
from slbench.core.validation.types import Length, Repeats

if TYPE_CHECKING:
    from slbench.cloud.files import MeasuredCloud


@command("slbench terms siemens-star --preview --repeats 5")
def terms(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SCENE|CLOUD...",
            help="A scene; or captures, clouds or folders of a plane, one a repeat.",
        ),
    ],
    repeats: Annotated[
        Repeats | None, typer.Option(help="Scans of a scene.  [default: 10]")
    ] = None,
    patch_mm: Annotated[
        Length | None,
        typer.Option(help="Side of a patch.  [default: a twelfth of the plane]"),
    ] = None,
    unit: Annotated[
        Unit | None, typer.Option(help="Of clouds, where the file does not say it.")
    ] = None,
    artefact: Annotated[
        str | None,
        typer.Option(help="Clouds: of which shipped artefact, or TOML of one; it is aligned."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: out/terms-NAME]")
    ] = None,
    seed: Seed = 0,
    changes: SceneChanges = None,
    measured_with: MeasuredWith = None,
    align: Align = False,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Measure precision, planarity, trueness, resolution."""
    from slbench.bench.terms.measure import cloud_terms, scene_terms
    from slbench.bench.terms.terms import TERMS_FOLDER, write_terms
    from slbench.objects import load_artefact

    first = Path(sources[0])
    measured = len(sources) > 1 or (first.exists() and first.suffix.lower() != ".toml")
    if measured:
        given = {
            "--repeats": repeats,
            "--set": changes,
            "--measured-with": measured_with,
            "--preview": preview or None,
            "--align": align or None,
        }
        for option, value in given.items():
            if value is not None:
                raise InputError(option, "a scene", ", ".join(sources)[:60])
        folder = out or Path("out") / f"terms-{first.stem}"
        TERMS_FOLDER.check(folder, "--out")
        clouds = [_cloud(Path(one), unit, allow_modules) for one in sources]
        part = None if artefact is None else load_artefact(artefact)
        found = cloud_terms(clouds, artefact=part, patch_mm=patch_mm, name=first.stem)
    else:
        for option, text in {"--unit": unit, "--artefact": artefact}.items():
            if text is not None:
                raise InputError(option, "clouds", sources[0])
        loaded = load_changed(
            sources[0],
            changes,
            preview=preview,
            allow_modules=allow_modules,
            measured_with=measured_with,
            align=align,
        )
        folder = out or Path("out") / f"terms-{loaded.name}"
        TERMS_FOLDER.check(folder, "--out")
        with progress(as_json) as report:
            found = scene_terms(
                loaded,
                repeats=repeats or 10,
                patch_mm=patch_mm,
                seed=seed,
                on_progress=report,
            )
    write_terms(found, folder)
    if as_json:
        print_json(found.to_dict() | {"out": folder})
        return
    print_table(found.table())
    for name, _, _, definition in {row[0]: row for row in found.rows()}.values():
        print(f"{name}: {definition}")
    print(f"Written to {folder}: open {folder / 'terms.png'}")


def _cloud(path: Path, unit: Unit | None, allow_modules: bool) -> MeasuredCloud:
    """Return the cloud of a capture, which is decoded, or of a file."""
    from slbench.capture.capture import MANIFEST, Capture
    from slbench.cloud.decoded import decode_capture
    from slbench.cloud.files import MeasuredCloud, read_cloud

    if not (path / MANIFEST).exists():
        return read_cloud(path, unit)
    decoded = decode_capture(Capture.load(path, allow_modules=allow_modules), where=path)
    cloud = decoded.cloud
    if cloud is None:
        raise InputError(path, "a capture with its rig", "none")
    return MeasuredCloud(cloud.points, pixels=cloud.pixels, shape=cloud.shape, source=str(path))
