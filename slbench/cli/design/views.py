"""``slbench design views``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slbench.cli.common import (
    AllowModules,
    Json,
    Preview,
    SceneChanges,
    SceneName,
    load_changed,
    print_json,
    print_table,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.validation.types import FINITE, Fraction, Interval, Step

if TYPE_CHECKING:
    from slbench.core.show.document import Table
    from slbench.design.views.plan import ViewPlan

Views = Annotated[int, Interval(ge=1, le=100)]
Candidates = Annotated[int, Interval(ge=1, le=5000)]
Poses = Annotated[int, Interval(ge=0, le=50)]
Samples = Annotated[int, Interval(ge=100, le=2_000_000)]
Tilt = Annotated[float, FINITE, Interval(ge=0.0, le=90.0)]
Incidence = Annotated[float, FINITE, Interval(ge=1.0, le=90.0)]
Clearance = Annotated[float, FINITE, Interval(ge=0.0, le=1000.0)]
Seconds = Annotated[float, FINITE, Interval(ge=1.0, le=3600.0)]
Index = Annotated[int, Interval(ge=0, le=10_000)]


@command("slbench design views ch7-engine-block --max-views 6 --max-std-um 40 --out out/views")
def views(
    scene: SceneName,
    max_views: Annotated[Views, typer.Option(help="Views, at most.")],
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/views"),
    stage: Annotated[
        Literal["rotary", "xyz", "robot"],
        typer.Option(help="Turntable, linear axes, or directions of a hemisphere."),
    ] = "rotary",
    candidates: Annotated[Candidates, typer.Option(help="Poses to choose from, about.")] = 200,
    coverage: Annotated[
        Fraction | None, typer.Option(help="Share to reach, by as few views as possible.")
    ] = None,
    min_measurements: Annotated[
        Views, typer.Option(help="Views that have to measure a place.")
    ] = 1,
    max_std_um: Annotated[
        Step | None, typer.Option(help="Largest standard deviation of a measurement.")
    ] = None,
    max_incidence_deg: Annotated[
        Incidence, typer.Option(help="Of the ways to both lenses from the normal.")
    ] = 80.0,
    stable_poses: Annotated[
        Poses | None,
        typer.Option(help="Of the part on a table; 0: as in the scene.  [default: by the stage]"),
    ] = None,
    tilt_deg: Annotated[
        Tilt, typer.Option(help="Of the turntable's axis from the line to the devices.")
    ] = 45.0,
    min_elevation_deg: Annotated[
        Tilt, typer.Option(help="Of a robot's views above the table.")
    ] = 20.0,
    clearance_mm: Annotated[
        Clearance, typer.Option(help="Between bodies of devices and the part.")
    ] = 5.0,
    volume: Annotated[
        bool, typer.Option("--volume/--anywhere", help="Count points in the volume alone.")
    ] = True,
    part: Annotated[Index, typer.Option("--object", help="Which object is measured.")] = 0,
    samples: Annotated[Samples, typer.Option(help="Places on the surface.")] = 20_000,
    time_limit_s: Annotated[Seconds, typer.Option(help="Of integer programming.")] = 30.0,
    changes: SceneChanges = None,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Choose the poses in which a part is to be scanned.

    Each candidate is predicted by free ways to both lenses and by the scan's own decoder; greedy
    cover and integer programming choose.  Scan the result with --views.
    """
    import numpy as np

    from slbench.core import resources
    from slbench.core.errors import InputError
    from slbench.design.views.candidates import Staging
    from slbench.design.views.plan import plan_views
    from slbench.report.plots.views import plan_folder, write_plan
    from slbench.simulate.viewpoints.views import Counting

    loaded = load_changed(scene, changes, preview=preview, allow_modules=allow_modules)
    source = resources.find("scenes", scene)
    plan_folder(loaded, source).check(out, "--out")
    if part >= len(loaded.objects):
        expected = f"one of the scene's {len(loaded.objects)} objects, from 0"
        raise InputError("--object", expected, part)
    staging = Staging(
        stage=stage,
        count=candidates,
        stable_poses=stable_poses,
        tilt_deg=tilt_deg,
        least_elevation_deg=min_elevation_deg,
    )
    counting = Counting(
        min_measurements=min_measurements,
        max_std_mm=np.inf if max_std_um is None else 1e-3 * max_std_um,
        max_incidence_deg=max_incidence_deg,
        within_volume=volume,
        samples=samples,
    )
    with progress(as_json) as report:
        plan = plan_views(
            loaded,
            max_views,
            part=part,
            staging=staging,
            counting=counting,
            coverage=coverage,
            clearance_mm=clearance_mm,
            time_limit_s=time_limit_s,
            hardware=_hardware(scene, loaded.specification, changes, allow_modules),
            on_progress=report,
        )
    parameters: dict[str, Any] = {
        "scene": loaded.specification,
        "object": part,
        "max_views": max_views,
        "coverage": coverage,
        "clearance_mm": clearance_mm,
        "time_limit_s": time_limit_s,
        "preview": preview,
        **vars(staging),
        **vars(counting),
    }
    write_plan(plan, out, loaded, source, parameters)
    if as_json:
        print_json(plan.to_dict() | {"out": out})
        return
    left_out = len(loaded.objects) - 1
    if left_out:
        print(f"{left_out} other object{'s' * (left_out > 1)} of the scene left out")
    print_table(_choices(plan))
    print_table(_poses(plan))
    for line in _solver(plan):
        print(line)
    print(
        f"Written to {out}: scan it with slbench scan {scene} --views {out / 'views.toml'}, "
        f"or a single view with slbench scan {out / 'view-01.toml'}"
    )


def _hardware(
    scene: str, content: dict[str, Any], changes: list[str] | None, allow_modules: bool
) -> Any:
    """Return the hardware of a scene with a ``[design]`` table; None of others."""
    from slbench.design.rig.hardware import load_hardware
    from slbench.scene.changes import read_changes

    devices = (content.get(name, {}) for name in ("camera", "projector"))
    bodies = all(one.get("body_mm") or one.get("barrel_mm") for one in devices)
    if "design" not in content or not bodies:
        return None
    made = read_changes(changes or (), "--set")
    return load_hardware(scene, allow_modules=allow_modules, changes=made)


def _choices(plan: ViewPlan) -> Table:
    """Lay out what each way chose."""
    from slbench.core.show.document import Table

    rows = [
        (
            f"{way} *" if way == plan.by else way,
            len(views),
            100 * plan.rows.coverage(views),
            100 * plan.patches.coverage(views),
        )
        for way, views in plan.choices.items()
    ]
    part = plan.scene.objects[0].artefact.name
    return Table(
        f"Choices for {part}", ("way", "views", "coverage / %", "of patches / %"), tuple(rows)
    )


def _poses(plan: ViewPlan) -> Table:
    from slbench.core.show.document import Table

    curve = plan.curve(plan.by)
    rows = [
        (view.name, view.description, 100 * covered)
        for view, covered in zip(plan.viewpoints().views, curve, strict=True)
    ]
    return Table("Views", ("view", "pose", "covered so far / %"), tuple(rows))


def _solver(plan: ViewPlan) -> list[str]:
    """Return what is said beside the tables, in lines."""
    solved, um = plan.solution, 1e3
    lines = [
        f"{100 * plan.coverage:.2f} % of the surface, {100 * plan.reachable:.2f} % within reach of "
        f"the {len(plan.candidates)} candidates; {100 * (1 - plan.reachable):.2f} % no view reaches"
    ]
    if plan.refused:
        why = ", ".join(f"{count} {reason}" for reason, count in plan.refused.items())
        lines.append(f"candidates that cannot be taken up: {why}")
    what = "views" if plan.wanted is not None else "of patches"
    unit = 1.0 if plan.wanted is not None else 100.0
    greedy = plan.patches.coverage(plan.choices["greedy"])
    own = float(len(plan.choices["greedy"])) if plan.wanted is not None else greedy
    lines.append(
        f"integer programming, {solved.rows} rows of {len(plan.patches.weights)} patches: "
        f"{unit * solved.value:.6g} {what}, bound {unit * solved.bound:.6g}, gap "
        f"{100 * solved.gap:.3g} %; greedy {unit * own:.6g}; {solved.seconds:.1f} s"
    )
    lines.append(f"solver: {solved.status}")
    if plan.margins_mm is not None:
        named = ", ".join(f"{name} {value:.4g}" for name, value in plan.margins_mm.items())
        lines.append(f"margins of the rig / mm: {named}")
    with_limit = plan.counting.max_std_mm
    if with_limit < float("inf"):
        lines.append(f"measurements of at most {um * with_limit:g} µm standard deviation")
    return lines
