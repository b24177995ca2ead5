"""``slbench design patterns --learn``."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from slbench.cli.common import load_changed, print_json, print_table, progress
from slbench.core.errors import InputError

if TYPE_CHECKING:
    from slbench.bench.compare.held_out import HeldOut, Verdict
    from slbench.core.show.document import Table
    from slbench.design.learned.learn import LearnedCode
    from slbench.patterns import PatternSequence
    from slbench.scene.model import Scene

#: Options that go with ``--learn``; all others are refused beside it.
OPTIONS = {
    *("learn", "scene", "data", "held_out", "frames", "max_fringes", "binary", "against", "steps"),
    *("seeds", "out", "scans", "seed", "changes", "preview", "allow_modules", "as_json"),
}
#: Share of a data set's objects that are held out, and at most so many scenes of them.
_HELD_OUT, _MOST_HELD_OUT = 0.25, 8
_SEEN = "judged on the scene that it was learned on: give --held-out, or learn on --data"


def run_learn(
    *,
    scene: str | None,
    data: str | None,
    held_out: list[str] | None,
    frames: int | None,
    max_fringes: int | None,
    binary: bool,
    against: Literal["matching", "bound"],
    steps: int,
    seeds: int,
    out: Path | None,
    scans: int | None,
    seed: int,
    changes: list[str] | None,
    preview: bool,
    allow_modules: bool,
    as_json: bool,
) -> None:
    """Learn pattern sets, hold them to fixed ones, and write them."""
    from slbench.core.extras import extra
    from slbench.core.io import OutputFolder, write_json

    extra("torch", "torch")
    if (scene is None) == (data is None):
        got = "neither" if scene is None else "both"
        raise InputError("--learn", "either --scene or --data", got)
    if data is not None and (changes or preview):
        raise InputError("--set" if changes else "--preview", "a --scene", "a data set")
    files = ("patterns.toml", "learned_*.png", "learned.json")
    inside = [f"seed-{seed + k}/{name}" for k in range(seeds) for name in files]
    kind = OutputFolder("learned patterns", (*files, *(inside if seeds > 1 else ())))
    folder = out or Path("out") / "learned-patterns"
    kind.check(folder, "--out")
    found = []
    with progress(as_json) as bar:

        def places(own: int) -> tuple[list[HeldOut], list[HeldOut]]:
            """Return the scenes that a seed learns on, and those held out."""
            if data is not None:
                train, test = _of_data(data, own, allow_modules)
            else:
                assert scene is not None  # as checked above
                one = load_changed(scene, changes, preview=preview, allow_modules=allow_modules)
                train, test = [_traced(one, own)], []
            for other in held_out or ():
                one = load_changed(other, changes, preview=preview, allow_modules=allow_modules)
                test.append(_traced(one, own))
            return train, test

        for own in range(seed, seed + seeds):

            def report(stage: str, own: int = own) -> Callable[[float], None]:
                label = stage if seeds == 1 else f"{stage}, seed {own}"
                return lambda fraction: bar(label, fraction) if bar else None

            start = time.perf_counter()
            train, test = places(own)
            seconds = {"light": time.perf_counter() - start}
            found.append(
                _learned(
                    *(train, test, scene or f"{data}", report, seconds),
                    frames=frames or 6,
                    count=max_fringes,
                    binary=binary,
                    against=against,
                    steps=steps,
                    scans=scans or 5,
                    seed=own,
                )
            )
    values = found[0].values if seeds == 1 else _together(found, seed)
    given = {"scene": scene, "data": data, "held_out": held_out, "changes": changes}
    times = {name: sum(one.seconds[name] for one in found) for name in found[0].seconds}
    with kind.writing(folder, given | values, seed, timings=times) as temporary:
        for k, one in enumerate(found):
            one.write(temporary if seeds == 1 else temporary / f"seed-{seed + k}")
        write_json(temporary / "learned.json", values)
    if as_json:
        print_json(values | {"seconds": times, "out": str(folder)})
        return
    if seeds > 1:
        print_table(_table_of_seeds(found, seed))
        low, high = values["ratio_ci95"]
        verdict = "The learned sets beat" if values["beats"] else "The learned sets do not beat"
        print(f"{verdict} the best fixed ones: {values['ratio']:.3f} of their error ", end="")
        print(f"[{low:.3f}, {high:.3f}], over {seeds} seeds")
        if not values["held_out"]:
            print(_SEEN)
        print(f"Written to {folder}")
        return
    (one,) = found
    print_table(_table(one.verdict, held_out=one.values["held_out"]))
    print(one.text)
    if not one.values["held_out"]:
        print(_SEEN)
    print(one.verdict.text())
    print(f"Written to {folder}: slbench compare SCENE --set {folder} --set {one.verdict.best}")


@dataclass(frozen=True)
class _Learned:
    """One code, held to fixed ones."""

    code: LearnedCode
    sequence: PatternSequence
    verdict: Verdict
    values: dict[str, Any]
    seconds: dict[str, float]

    @property
    def text(self) -> str:
        scenes, code = len(self.values["learned_on"]), self.code
        kind = "binary frames from" if code.blur_px else "frames of"
        return (
            f"{self.sequence.n_frames} {kind} up to {code.count} cycles, learned on {scenes} "
            f"scene{'s' * (scenes > 1)}: {code.deviation_px:.4f} px, {code.lost:.2%} of the "
            "pixels lost, as predicted"
        )

    def write(self, folder: Path) -> None:
        from slbench.core.io import write_json, write_toml

        folder.mkdir(exist_ok=True)
        write_toml(folder / "patterns.toml", {"patterns": self.sequence.to_dict(folder)})
        write_json(folder / "learned.json", self.values)


def _learned(
    train: list[HeldOut],
    test: list[HeldOut],
    where: str,
    report: Callable[[str], Callable[[float], None]],
    seconds: dict[str, float],
    *,
    frames: int,
    count: int | None,
    binary: bool,
    against: Literal["matching", "bound"],
    steps: int,
    scans: int,
    seed: int,
) -> _Learned:
    """Learn one code on its scenes, and hold it to fixed sets on the others."""
    from slbench.bench.compare.held_out import hold
    from slbench.bench.compare.sets import PatternSet
    from slbench.design.learned.learn import learn, lit_of

    lights = [lit_of(p.scene, p.transports[0], p.truth, seed) for p in train]
    usable = [light for light in lights if light is not None]
    if not usable:
        expected = "smooth surface that the projector lights, 320 pixels of it"
        raise InputError(where, expected, "none")
    start = time.perf_counter()
    code = learn(
        usable,
        frames,
        count=count,
        binary=binary,
        against=against,
        steps=steps,
        seed=seed,
        on_progress=report("learn"),
    )
    seconds["learn"] = time.perf_counter() - start
    start = time.perf_counter()
    sequence = code.sequence(train[0].transports[0].panel[1])
    verdict = hold(
        PatternSet("learned", sequence),
        test or train,
        repeats=scans,
        seed=seed,
        on_progress=report("hold"),
    )
    seconds["hold"] = time.perf_counter() - start
    values: dict[str, Any] = {
        "frames": sequence.n_frames,
        "count": code.count,
        "binary": binary,
        "blur_px": code.blur_px,
        "against": against,
        "steps": steps,
        "seed": seed,
        "learned_on": [p.name for p, light in zip(train, lights, strict=True) if light],
        "predicted_px": code.deviation_px,
        "predicted_lost": code.lost,
        "held_out": bool(test),
        "verdict": verdict.to_dict(),
    }
    return _Learned(code, sequence, verdict, values, seconds)


def _together(found: Sequence[_Learned], seed: int) -> dict[str, Any]:
    """Return what several seeds come to."""
    from slbench.bench.compare.held_out import over_seeds

    verdicts = [one.verdict for one in found]
    ratio, interval = over_seeds(verdicts)
    same = {
        key: found[0].values[key] for key in ("frames", "binary", "against", "steps", "held_out")
    }
    return same | {
        "seeds": [seed + k for k in range(len(found))],
        "ratio": ratio,
        "ratio_ci95": list(interval),
        "beats": interval[1] < 1.0 and all(one.keeps for one in verdicts),
        "verdicts": [one.to_dict() for one in verdicts],
    }


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


def _table(verdict: Verdict, *, held_out: bool) -> Table:
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
    where = "held-out scenes" if held_out else "the scene that was learned on"
    return Table(f"Distance from the truth on {where}", columns, tuple(rows))


def _table_of_seeds(found: Sequence[_Learned], seed: int) -> Table:
    """Lay out the verdict on each seed's code."""
    from slbench.core.show.document import Table

    rows = [
        (
            seed + k,
            f"{{{one.verdict.best}}}",
            f"{one.verdict.ratio:.3f} [{one.verdict.ratio_ci95[0]:.3f}, "
            f"{one.verdict.ratio_ci95[1]:.3f}]",
            f"{one.verdict.right:.2%}",
            f"{one.verdict.fixed_right:.2%}",
        )
        for k, one in enumerate(found)
    ]
    columns = ("seed", "best fixed set", "ratio of errors", "right", "right, fixed")
    unseen = found[0].values["held_out"]
    where = "scenes that they have not seen" if unseen else "the scene that they were learned on"
    title = f"Codes of {len(found)} seeds on {where}"
    return Table(title, columns, tuple(rows))
