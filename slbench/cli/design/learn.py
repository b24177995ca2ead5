"""``slbench design patterns --learn``."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from slbench.cli.common import load_changed, print_json, print_table, progress
from slbench.core.errors import InputError

if TYPE_CHECKING:
    from slbench.bench.compare.held_out import HeldOut, Verdict
    from slbench.core.show.document import Table
    from slbench.scene.model import Scene

#: Options that go with ``--learn``; all others are refused beside it.
OPTIONS = {
    *("learn", "scene", "data", "held_out", "frames", "max_fringes", "against", "steps", "out"),
    *("scans", "seed", "changes", "preview", "allow_modules", "as_json"),
}
#: Share of a data set's objects that are held out, and at most so many scenes of them.
_HELD_OUT, _MOST_HELD_OUT = 0.25, 8


def run_learn(
    *,
    scene: str | None,
    data: str | None,
    held_out: list[str] | None,
    frames: int | None,
    max_fringes: int | None,
    against: Literal["matching", "bound"],
    steps: int,
    out: Path | None,
    scans: int | None,
    seed: int,
    changes: list[str] | None,
    preview: bool,
    allow_modules: bool,
    as_json: bool,
) -> None:
    """Learn a pattern set, hold it to fixed ones, and write it."""
    from slbench.core.extras import extra
    from slbench.core.io import OutputFolder, write_json, write_toml

    extra("torch", "torch")
    from slbench.bench.compare.held_out import hold
    from slbench.bench.compare.sets import PatternSet
    from slbench.design.learned.learn import learn, lit_of

    if (scene is None) == (data is None):
        got = "neither" if scene is None else "both"
        raise InputError("--learn", "either --scene or --data", got)
    if data is not None and (changes or preview):
        raise InputError("--set" if changes else "--preview", "a --scene", "a data set")
    kind = OutputFolder("learned patterns", ("patterns.toml", "learned_*.png", "learned.json"))
    folder = out or Path("out") / "learned-patterns"
    kind.check(folder, "--out")
    seconds: dict[str, float] = {}
    with progress(as_json) as bar:

        def report(stage: str) -> Callable[[float], None]:
            return lambda fraction: bar(stage, fraction) if bar else None

        start = time.perf_counter()
        if data is not None:
            train, test = _of_data(data, seed, allow_modules)
        else:
            assert scene is not None  # as checked above
            own = load_changed(scene, changes, preview=preview, allow_modules=allow_modules)
            train = [_traced(own, seed)]
            test = []
        for other in held_out or ():
            one = load_changed(other, changes, preview=preview, allow_modules=allow_modules)
            test.append(_traced(one, seed))
        lights = [lit_of(p.scene, p.transports[0], p.truth, seed) for p in train]
        usable = [light for light in lights if light is not None]
        if not usable:
            expected = "smooth surface that the projector lights, 320 pixels of it"
            raise InputError(f"scene {train[0].name}" if scene else f"{data}", expected, "none")
        seconds["light"] = time.perf_counter() - start
        start = time.perf_counter()
        code = learn(
            usable,
            frames or 6,
            count=max_fringes,
            against=against,
            steps=steps,
            seed=seed,
            on_progress=report("learn"),
        )
        seconds["learn"] = time.perf_counter() - start
        start = time.perf_counter()
        sequence = code.sequence(train[0].transports[0].panel[1])
        judged = test or train
        verdict = hold(
            PatternSet("learned", sequence),
            judged,
            repeats=scans or 5,
            seed=seed,
            on_progress=report("hold"),
        )
        seconds["hold"] = time.perf_counter() - start
    values: dict[str, Any] = {
        "frames": sequence.n_frames,
        "count": code.count,
        "against": against,
        "steps": steps,
        "learned_on": [p.name for p, light in zip(train, lights, strict=True) if light],
        "predicted_px": code.deviation_px,
        "predicted_lost": code.lost,
        "held_out": bool(test),
        "verdict": verdict.to_dict(),
    }
    given = {"scene": scene, "data": data, "held_out": held_out, "changes": changes}
    with kind.writing(folder, given | values, seed, timings=seconds) as temporary:
        write_toml(temporary / "patterns.toml", {"patterns": sequence.to_dict(temporary)})
        write_json(temporary / "learned.json", values)
    if as_json:
        print_json(values | {"seconds": seconds, "out": str(folder)})
        return
    print_table(_table(verdict))
    print(
        f"{sequence.n_frames} frames of up to {code.count} cycles, learned on {len(usable)} "
        f"scene{'s' * (len(usable) > 1)}: {code.deviation_px:.4f} px, {code.lost:.2%} of the "
        "pixels lost, as predicted"
    )
    if not test:
        print("judged on the scene that it was learned on: give --held-out, or learn on --data")
    print(verdict.text())
    print(f"Written to {folder}: slbench compare SCENE --set {folder} --set {verdict.best}")


def _traced(scene: Scene, seed: int) -> HeldOut:
    from slbench.bench.compare.held_out import HeldOut
    from slbench.simulate.render.groundtruth import ground_truth
    from slbench.simulate.stack import traced

    if scene.focus is not None:
        raise InputError(f"scene {scene.name}: focus", "one picture", "a focus stack")
    truth = ground_truth(scene.objects, scene.rig)
    return HeldOut(scene.name, scene, traced(scene, ("u",), seed=seed), truth)


def _of_data(path: str, seed: int, allow_modules: bool) -> tuple[list[HeldOut], list[HeldOut]]:
    """Return the scenes of a data set to learn on, and those held out."""
    from slbench.bench.compare.held_out import HeldOut
    from slbench.datasets import open_dataset

    whole = open_dataset(path, allow_modules=allow_modules)
    parts = whole.split(train=1.0 - _HELD_OUT, test=_HELD_OUT, seed=seed)
    found = {
        name: [
            HeldOut(f"sample {one.number}", one.scene, (one.transport,), one.truth)
            for one in part
            if one.truth.smooth().any()
        ]
        for name, part in parts.items()
    }
    test = [one for one in found["test"] if one.truth.smooth().sum() >= 300][:_MOST_HELD_OUT]
    if not found["train"] or not test:
        expected = "samples with smooth lit surface, to learn on and to hold out"
        raise InputError(path, expected, f"{len(found['train'])} and {len(test)}")
    return found["train"], test


def _table(verdict: Verdict) -> Table:
    """Lay out both sets on each scene, and the fixed sets below."""
    from slbench.core.show.document import Table

    rows = [
        (
            one.scene,
            f"{1e3 * one.learned.error_median_mm:.2f}",
            f"{1e3 * one.fixed.error_median_mm:.2f}",
            f"{one.ratio:.3f} [{one.ratio_ci95[0]:.3f}, {one.ratio_ci95[1]:.3f}]",
            f"{one.learned.right:.2%}",
            f"{one.fixed.right:.2%}",
        )
        for one in verdict.scenes
    ]
    best = f"{{{verdict.best}}}"
    columns = ("scene", "learned / µm", f"{best} / µm", "ratio", "right", f"right, {best}")
    return Table("Distance from the truth on held-out scenes", columns, tuple(rows))
