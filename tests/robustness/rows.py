"""The inputs that are fuzzed, a row a kind: to fuzz a new format, add its row.

A row makes a folder of good input once, and says which file is spoilt and what the cheapest command
is that reads it.  Good input is tiny, so that a case costs milliseconds.
"""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import mutate
import numpy as np
import tomli_w
import trimesh
from fuzz import Case, Row
from scenes_small import run_cli

from slbench.cli import SECTIONS
from slbench.cli.lazy import Group
from slbench.core import resources
from slbench.core.io import write_npz, write_ply
from slbench.core.io.images import write_exr, write_png, write_tiff
from slbench.core.registry import resolved
from slbench.patterns import PatternSequence
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.rig.files.writing import write_calibration
from slbench.scene.file import read_merged
from slbench.scene.truth import GroundTruth
from slbench.simulate.transport import LightTransport

SCENE: dict[str, Any] = {
    "extends": "hardware/macro-ch6",
    "name": "tiny",
    "camera": {"resolution_px": [24, 18], "pitch_um": 197.0, "focal_length_mm": 16.0},
    "objects": [
        {"artefact": "step-block-5", "material": "matt-white-spray", "position_mm": [0.0, 0.0, 0.0]}
    ],
    "patterns": {"sequence": "1,8", "shifts": 3, "axes": "u"},
    "light": {"ambient_w_per_m2": 0.01, "bounces": 0},
    "exposure": {"white_level": 0.8},
    "detector": {"bit_depth": 8, "full_well_e": 16000.0, "read_noise_e": 12.0},
    "materials": {"paint": {"bsdf": "diffuse", "albedo": 0.5}},
    "render": {"samples": 4},
}


def good(*arguments: object) -> None:
    """Run a command that must succeed."""
    outcome = run_cli(*arguments)
    assert outcome.status == 0, outcome.err


def scanned(folder: Path) -> None:
    """Make ``capture``, a scan of the tiny scene."""
    (folder / "scene.toml").write_text(tomli_w.dumps(SCENE))
    scan = ["scan", folder / "scene.toml", "--no-score", "--no-picture"]
    good(*scan, "--out", folder / "capture")


def of_file(
    name: str,
    path: str,
    command: str,
    prepare: Callable[[Path], None],
    mutator: Callable[[Path], mutate.Mutator],
    weight: float = 1.0,
    call: Callable[[Path], Any] | None = None,
) -> Row:
    """Return the row of one file that is spoilt; `mutator` gets the good one."""
    known: dict[Path, mutate.Mutator] = {}

    def make(random: mutate.Random, folder: Path) -> Case:
        if folder not in known:
            known[folder] = mutator(folder / path)
        return Case({path: known[folder](random)}, command.split())

    return Row(name, prepare, make, weight, call)


def toml_of(path: Path) -> mutate.Mutator:
    """Spoil a TOML file."""
    return mutate.of_tables(tomllib.loads(path.read_text()), mutate.toml)


def json_of(path: Path) -> mutate.Mutator:
    """Spoil a JSON file."""
    import json

    return mutate.of_tables(json.loads(path.read_text()), mutate.as_json)


def cells_of(path: Path) -> mutate.Mutator:
    """Spoil a CSV file."""
    return mutate.of_cells(path.read_bytes())


def text_of(path: Path) -> mutate.Mutator:
    """Spoil text with numbers in it."""
    return mutate.of_text(path.read_text())


def bytes_of(path: Path) -> mutate.Mutator:
    """Spoil bytes."""
    return mutate.of_bytes(path.read_bytes())


# --- scenes, artefacts, meshes ---------------------------------------------------------------


def scene(folder: Path) -> None:
    """Make a scene."""
    (folder / "scene.toml").write_text(tomli_w.dumps(SCENE))


def designed_scene(folder: Path) -> None:
    """Make a scene with all of its rig spelt out."""
    hardware = read_merged(resources.find("scenes", "hardware/macro-ch6"))
    content = {k: v for k, v in hardware.items() if k != "design"} | SCENE
    content["camera"] = hardware["camera"] | SCENE["camera"]
    del content["extends"]
    (folder / "scene.toml").write_text(tomli_w.dumps(content))


def sheet_scene(folder: Path) -> None:
    """Make a scene whose devices are described by their data sheets."""
    content = SCENE | {
        "camera": {"resolution_px": [24, 18], "sensor_format": "1/2", "lens_format": "2/3"}
        | {"lens_mm": 16.0, "lens_f_number": 4.0},
        "projector": {"resolution_px": [608, 684], "micromirror_um": 7.637}
        | {"micromirrors": "diamond", "throw_ratio": 1.66, "zoom": 1.1}
        | {"offset_percent": 10.0, "flux_lm": 20.0},
        "detector": {"snr_max_db": 40.3, "dynamic_range_db": 71.2},
        "rig": {
            "camera": {"position_mm": [0.0, 0.0, 400.0]},
            "projector": {"position_mm": [150.0, 0.0, 400.0]},
        },
    }
    del content["extends"]
    (folder / "scene.toml").write_text(tomli_w.dumps(content))


def artefact(name: str) -> Callable[[Path], None]:
    """Return what copies a shipped artefact."""

    def prepare(folder: Path) -> None:
        (folder / "o.toml").write_bytes(resources.find("objects", name).read_bytes())

    return prepare


def mesh(suffix: str) -> Callable[[Path], None]:
    """Return what makes an artefact of a mesh file."""

    def prepare(folder: Path) -> None:
        path = f"m.{suffix.partition('_')[0]}"
        box = trimesh.creation.icosphere(subdivisions=1, radius=10.0)
        box.export(folder / path, file_type=suffix)
        content = {"kind": "mesh", "source": "x", "parameters": {"path": path, "unit": "mm"}}
        (folder / "o.toml").write_text(tomli_w.dumps(content))

    return prepare


def declared_part(folder: Path) -> None:
    """Write a mesh and a file that declares features of every type on it."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=10.0)
    block = trimesh.creation.box([30.0, 20.0, 10.0])
    pin = trimesh.creation.cylinder(4.0, 8.0, sections=24)
    ball.apply_translation([0.0, 0.0, 40.0])
    pin.apply_translation([0.0, 0.0, 9.0])
    trimesh.util.concatenate([block, pin, ball]).export(folder / "m.stl")
    features: list[dict[str, Any]] = [
        {"name": "top", "type": "plane", "box_mm": [[-15, -10, 4], [15, 10, 6]], "margin_mm": 0.5},
        {"name": "pin", "type": "cylinder", "grow": {"from_mm": [4, 0, 10], "within_deg": 25.0}},
        {"name": "ball", "type": "sphere", "sphere": {"centre_mm": [0, 0, 40], "radius_mm": 11}},
        {
            **{"name": "rim", "type": "circle", "nominal": {"radius_mm": 4.0}},
            "cylinder": {"from_mm": [0, 0, 12], "to_mm": [0, 0, 14], "radius_mm": 5.0},
        },
    ]
    dimensions: list[dict[str, Any]] = [
        {"name": "d", "type": "distance", "of": ["ball", "top"], "tolerance_mm": [-9.0, 9.0]},
        {"name": "s", "type": "perpendicularity", "of": ["pin", "top"], "tolerance_mm": 0.1},
        {"name": "a", "type": "angle", "of": ["pin", "top"], "value_deg": 90.0},
    ]
    content = {"kind": "mesh", "source": "x", "parameters": {"path": "m.stl", "unit": "mm"}}
    content |= {"features": features, "dimensions": dimensions}
    (folder / "o.toml").write_text(tomli_w.dumps(content))


BUILD = "objects build o.toml --out out/m.stl"
#: Those whose building takes a second or more are tried less often.
ARTEFACTS = {
    "plane": 1.0,
    "plate": 1.0,
    "step-block-5": 1.0,
    "sphere": 0.5,
    "ball-bar": 0.3,
    "sinusoid": 0.3,
    "pyramid-array": 0.5,
    "chequerboard": 0.5,
    "charuco": 0.3,
    "circle-grid": 0.3,
    "calibration-grid": 0.3,
    "micro-lens": 0.3,
    "bowl": 0.3,
    "brick": 0.3,
    "spur-gear": 0.3,
    "double-helical-gear": 0.1,
    "curved-gear": 0.1,
    "watch-gear": 0.1,
    "coin-3": 0.1,
    "propeller-3": 0.1,
    "engine-block": 0.1,
}
TEXT_MESHES = ("obj", "off", "stl_ascii", "gltf")

# --- captures --------------------------------------------------------------------------------


#: Ways of keeping frames: what ``frames`` says, and the file that is spoilt.
KEPT = {
    "glob": ("kept/*.png", "kept/2.png"),
    "colour": (["kept/0.png#r", "kept/0.png#g", "kept/0.png#b", "kept/1*.png"], "kept/0.png"),
    "pages": ("kept/all.tif", "kept/all.tif"),
    "left-aligned": ("kept/*.png", "kept/2.png"),
    "float": ("kept/*.tiff", "kept/2.tiff"),
    "exr": ("kept/*.exr", "kept/2.exr"),
    "npy": ("kept/*.npy", "kept/2.npy"),
}


def kept(kind: str) -> Callable[[Path], None]:
    """Return what makes ``capture`` with its frames kept in another way."""

    def prepare(folder: Path) -> None:
        scanned(folder)
        capture = folder / "capture"
        frames = [cv2.imread(str(p), -1) for p in sorted((capture / "frames").glob("*.png"))]
        (capture / "kept").mkdir()
        if kind == "pages":
            assert cv2.imwritemulti(str(capture / "kept/all.tif"), frames)
        elif kind == "colour":
            write_png(capture / "kept/0.png", np.stack(frames[:3], axis=-1))
            frames = frames[3:]
        for k, frame in enumerate(frames):
            if kind == "left-aligned":
                write_png(capture / f"kept/{k}.png", frame.astype(np.uint16) << 8)
            elif kind == "float":
                write_tiff(capture / f"kept/{k}.tiff", frame.astype(np.float32))
            elif kind == "exr":
                write_exr(capture / f"kept/{k}.exr", {"Y": frame.astype(np.float32)})
            elif kind == "npy":
                np.save(capture / f"kept/{k}.npy", frame)
            elif kind != "pages":
                write_png(capture / f"kept/{'1' * (kind == 'colour')}{k}.png", frame)
        manifest = tomllib.loads((capture / "capture.toml").read_text())
        manifest.pop("bit_depth", None)
        manifest["frames"] = KEPT[kind][0]
        (capture / "capture.toml").write_text(tomli_w.dumps(manifest))

    return prepare


def photographs(suffix: str) -> Callable[[Path], None]:
    """Return what makes three photographs."""

    def prepare(folder: Path) -> None:
        random = np.random.default_rng(1)
        (folder / "photos").mkdir()
        for k in range(3):
            image = random.integers(0, 255, (24, 32), dtype=np.uint8)
            content = cv2.imencode(f".{suffix}", image)[1].tobytes()
            (folder / "photos" / f"{k}.{suffix}").write_bytes(content)

    return prepare


def fitted(folder: Path) -> None:
    """Make ``points.csv``, the model of its fit, and a capture."""
    points(folder)
    scanned(folder)
    good("calibrate", "fit", folder / "points.csv", "--out", folder / "model.json")


def points(folder: Path) -> None:
    """Make points of a polynomial calibration, near the pixels of the tiny capture."""
    random = np.random.default_rng(2)
    u, v, p = random.uniform((0, 0, 50), (24, 18, 590), (120, 3)).T
    x, y, z = 0.5 * u - 6 + 1e-3 * p, 0.4 * v - 4, 0.1 * p - 5 - 0.2 * u
    noise = random.normal(0, 0.01, (3, 120))
    row = 0.5 * p + random.uniform(-20.0, 20.0, 120)
    table = np.column_stack([u, v, p, row, x + noise[0], y + noise[1], z + noise[2]])
    header = "u_c,v_c,u_p,v_p,x_mm,y_mm,z_mm"
    np.savetxt(folder / "points.csv", table, "%.9g", ",", header=header, comments="")


def views(folder: Path) -> None:
    """Make two views and their positions."""
    random = np.random.default_rng(3)
    x, y = random.uniform(-3, 3, (2, 1500))
    z = 0.3 * np.sin(2 * x) * np.cos(2 * y)
    cloud = np.column_stack([x, y, z])
    for k, shift in enumerate((0.0, 0.5)):
        write_ply(
            folder / f"v{k}.ply", cloud + np.array([shift, 0, 0]), {"quality": np.ones(len(x))}
        )
    (folder / "pos.csv").write_text("x_mm,y_mm,z_mm\n0,0,0\n0.5,0,0\n")


def pattern_sets(folder: Path) -> None:
    """Make a pattern set as a table, as pictures, and as an object of a module."""
    words = "white+gray+1,8@4+micro+xor2+orders8@3+hamiltonian4+speckle6"
    table = PatternSequence.parse(words, (64, 48)).to_dict()
    (folder / "set.toml").write_text(tomli_w.dumps({"patterns": table}))
    (folder / "pictures").mkdir()
    for k, image in enumerate(PatternSequence.parse("1,4", (64, 48)).images()):
        write_png(folder / "pictures" / f"{k}.png", np.rint(255 * image).astype(np.uint8))
    lines = ["from slbench.patterns import Fringes", "SET = [Fringes(1, 3), Fringes(8, 4)]"]
    (folder / "mine.py").write_text("\n".join(lines) + "\n")


def stack(folder: Path) -> None:
    """Make a stack of three captures."""
    scanned(folder)
    good_capture, folder = folder / "capture", folder / "stack"
    folder.mkdir()
    for k in range(3):
        (folder / f"c{k}").mkdir()
        (folder / f"c{k}" / "frames").mkdir()
        for path in (good_capture / "frames").iterdir():
            (folder / f"c{k}" / "frames" / path.name).write_bytes(path.read_bytes())
        for name in ("capture.toml", "rig.yaml"):
            (folder / f"c{k}" / name).write_bytes((good_capture / name).read_bytes())
    content = {"captures": ["c0", "c1", "c2"], "camera_mm": [430.0, 450.0, 470.0]}
    (folder / "stack.toml").write_text(tomli_w.dumps(content))


# --- design, claims, data sets -----------------------------------------------------------------


def hardware(folder: Path) -> None:
    """Make hardware, configurations, and a front of a search."""
    content = read_merged(resources.find("scenes", "hardware/macro-ch6"))
    (folder / "hw.toml").write_text(tomli_w.dumps(content))
    table = resources.find("scenes", "hardware/macro-ch6").with_name("table4.csv").read_text()
    (folder / "table.csv").write_text("\n".join(table.splitlines()[:3]) + "\n")


def front(folder: Path) -> None:
    """Make a front to go on from."""
    hardware(folder)
    search = ["design", "rig", folder / "hw.toml", "--evaluations", "20"]
    good(*search, "--start", folder / "table.csv", "--out", folder / "found")
    (folder / "front.npz").write_bytes((folder / "found" / "front.npz").read_bytes())


def noise_table(folder: Path) -> None:
    """Make a table of phase noise."""
    rows = [f"{n},{z},{0.03 + 0.0001 * n}" for n in (1, 2, 4, 8, 16) for z in (-1, 0, 1)]
    (folder / "noise.csv").write_text("fringes,z_mm,sigma_rad\n" + "\n".join(rows) + "\n")


def claims(folder: Path) -> None:
    """Make claims of the tiny scene, and a baseline."""
    scene(folder)
    claim = {"name": "one", "scene": "scene.toml", "quantity": "completeness", "min": 0.0}
    claim["repeats"] = 2
    other = {"name": "two", "scene": "scene.toml", "quantity": "rms_mm", "max": 10.0, "repeats": 2}
    (folder / "a.claims.toml").write_text(tomli_w.dumps({"claim": [claim, other]}))


def baseline(folder: Path) -> None:
    """Make claims and their baseline."""
    claims(folder)
    good("check", folder / "a.claims.toml", "--update", "--baseline", folder / "b.json")


def dataset_spec(folder: Path) -> None:
    """Make a specification of tiny samples."""
    from dataset_specs import write_spec

    write_spec(folder)


def dataset(folder: Path) -> None:
    """Make a data set of one sample."""
    dataset_spec(folder)
    make = ["dataset", "make", folder / "tiny.toml", "--out", folder / "data"]
    good(*make, "--count", 1, "--workers", 0)


def of_dataset(name: str, pattern: str, command: str, weight: float) -> Row:
    """Return the row of a data set's file, found by its pattern."""

    def make(random: mutate.Random, folder: Path) -> Case:
        path = next(folder.glob(pattern))
        content = path.read_bytes()
        mutator = json_of(path) if path.suffix == ".json" else mutate.of_bytes(content)
        return Case({str(path.relative_to(folder)): mutator(random)}, command.split())

    return Row(name, dataset, make, weight)


# --- arrays and images that commands reach only through a data set -------------------------------


def arrays_of(path: Path) -> mutate.Mutator:
    """Spoil an NPZ: its bytes, or arrays of other shapes and types."""
    content = path.read_bytes()
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}

    def mutate_arrays(random: mutate.Random) -> bytes:
        if random.random() < 0.5:
            return mutate.damaged(random, content)
        changed = dict(arrays)
        name = mutate.pick(random, sorted(changed))
        value = changed[name]
        match int(random.integers(7)):
            case 0:
                del changed[name]
            case 1:
                changed[name] = np.array(mutate.pick(random, mutate.NUMBERS[:12]))
            case 2:
                changed[name] = np.full_like(value, -1) if value.dtype.kind in "if" else value[:0]
            case 3:
                changed[name] = np.full(value.shape, mutate.pick(random, mutate.NUMBERS[-14:]))
            case 4:
                changed[name] = value[..., None]
            case 5:
                changed[name] = value.astype(str)
            case _:
                changed[name] = value.ravel()[: value.size // 2]
        other = path.with_name("changed.npz")
        write_npz(other, **changed)
        made = other.read_bytes()
        other.unlink()
        return made

    return mutate_arrays


def truth(folder: Path) -> None:
    """Make a ground truth."""
    (folder / "scene.toml").write_text(tomli_w.dumps(SCENE))
    good("scan", folder / "scene.toml", "--no-picture", "--out", folder / "capture")


#: Files of rigs of other programs, by format; the first is spoilt.
CALIBRATIONS = {
    "slstudio": ("c.xml",),
    "opencv": ("c.yml",),
    "bouguet": ("c.mat",),
    "ros": ("c-camera.yaml", "c-projector.yaml", "c-transform.yaml"),
    "mrcal": ("c-camera.cameramodel", "c-projector.cameramodel"),
}
STATED = "--unit mm --order camera-projector --size-camera 24x18 --size-projector 24x18 --json"


def calibration(name: str) -> Callable[[Path], None]:
    """Return what makes the files of a format."""

    def prepare(folder: Path) -> None:
        lens = Camera(24, 18, (0.1, 0.1), Lens(16.0), distortion=(0.1, 0.2, 0.0, 0.0, 0.0))
        other = Projector(24, 18, (0.1, 0.1), Lens(20.0), pose=Pose(position=[100.0, 0.0, 0.0]))
        suffix = Path(CALIBRATIONS[name][0]).suffix
        write_calibration(folder / f"c{suffix}", Rig(lens, other), name)

    return prepare


# --- the command line ----------------------------------------------------------------------------

OPTIONS = [
    *("-1", "0", "1", "3", "1e308", "nan", "inf", "99999999999999999999", "2147483648", "", "x"),
    *("1,2", "1,2,4", "gray", "1,8@4", "a=1", "../../x", "/", ".", "\u202e", "x" * 300, "x" * 5000),
    *("gone.toml", "gone.py:SET", "1,2 | gone.py:f", "./", "a:b", "os:getcwd", "1,2|"),
    *("-", "--", "{}", "'", "a\nb", "NaN,NaN", "0.5", "1,2,3@999999999", "65537", "1@3,99999@3"),
]
#: Enough for each command to begin; the files are good ones or missing.
STARTS = {
    "scan": "scene.toml --no-score --no-picture --out out",
    "decode": "capture --out out",
    "fuse": "photos --out out/a.png",
    "register": "v0.ply v1.ply --positions pos.csv --out out",
    "score": "v0.ply --artefact plane --placed --out out",
    "calibrate board": "capture --board chequerboard --size 9x7 --pitch-mm 8 --out out/r.yaml",
    "calibrate combine": "capture/rig.yaml capture/rig.yaml capture --board chequerboard "
    "--size 9x7 --pitch-mm 8 --out out/r.yaml",
    "calibrate fit": "points.csv --out out/m.json",
    "calibrate apply": "model.json capture --out out/c.ply",
    "calibrate run": "missing --out out",
    "compare": "missing --set 1,2 --out out",
    "check": "missing.toml",
    "bench": "missing --out out",
    "design rig": "missing --out out",
    "design evaluate": "hw.toml table.csv",
    "design verify": "missing --out out",
    "design noise": "missing --out out",
    "design patterns": "--width-px 64 --noise-rad 0.03",
    "dataset make": "missing --count 1 --workers 0 --out out",
    "dataset export": "missing --out out",
    "dataset info": "missing",
    "dataset verify": "missing",
    "rig show": "capture/rig.yaml --out out/a.png",
    "rig convert": "capture/rig.yaml out/rig.yaml",
    "scene show": "missing --out out/a.png",
    "scene list": "",
    "scene new": "out/a.toml --camera basler-aca1920-40um --projector ti-lightcrafter --lens-mm 25 "
    "--focus-mm 300 --baseline-mm 110 --object plane --overwrite",
    "scene copy": "plane out/a.toml --overwrite",
    "objects build": "plane --out out/m.stl",
    "objects show": "missing --out out/a.png",
    "objects list": "--kinds",
    "export": "scene.toml out/a.xml --pinhole",
}
#: Options that name what is written.
WRITTEN = {"--out", "--report", "--plot", "--write-noise", "--junit", "--baseline"}
#: Not run with whatever comes: a render of a minute, or the test of the machine.
TOO_LONG = {"doctor"}


def everything(folder: Path) -> None:
    """Make all that the commands of :data:`STARTS` name."""
    fitted(folder)
    views(folder)
    hardware(folder)
    photographs("png")(folder)


def commands() -> dict[str, Any]:
    """Return every command by its words."""
    rows = {name: row for part in SECTIONS.values() for name, row in part.items()}
    found = {}
    for name, row in rows.items():
        command = resolved(row)
        if isinstance(command, Group):
            found |= {f"{name} {inner}": one for inner, one in command.commands.items()}
        else:
            found[name] = command
    return {name: command for name, command in found.items() if name not in TOO_LONG}


def command_line(random: mutate.Random, folder: Path) -> Case:
    """Return a command with options that are wrong, twice, or without their value."""
    known = commands()
    name = mutate.pick(random, sorted(known))
    names = inspect.signature(inspect.unwrap(known[name].callback)).parameters
    options = [max(p.opts, key=len) for p in known[name].params if p.name in names]
    options = [option for option in options if option.startswith("--")] or ["--stranger"]
    words = [*name.split(), *STARTS.get(name, "missing").split()]
    for _ in range(int(random.integers(1, 3))):
        option = mutate.pick(random, options) if random.random() < 0.95 else "--stranger"
        words.append(option)
        if random.random() < 0.95:
            words.append(mutate.pick(random, OPTIONS))
    if random.random() < 0.1:
        words.pop(int(random.integers(len(words))))
    # What is written lands in ``out``: the folder's other files are watched.
    for k, word in enumerate(words[:-1]):
        name = words[k + 1]
        if word in WRITTEN and not name.startswith(("out", "--")) and name:
            words[k + 1] = "out/x" if name in (".", "/", "../../x") else f"out/{name}"
    return Case({}, words)


DECODE = "decode capture --out out"
ROWS: list[Row] = [
    of_file("scene", "scene.toml", "export scene.toml out/a.xml --pinhole", scene, toml_of),
    of_file(
        *("scene by data sheets", "scene.toml"),
        "scan scene.toml --no-score --no-picture --out out",
        *(sheet_scene, toml_of, 0.7),
    ),
    of_file(
        *("scene scanned", "scene.toml"),
        "scan scene.toml --no-score --no-picture --out out",
        *(designed_scene, toml_of, 0.7),
    ),
    *(
        of_file(f"artefact {name}", "o.toml", BUILD, artefact(name), toml_of, weight)
        for name, weight in ARTEFACTS.items()
    ),
    of_file("declared features", "o.toml", BUILD, declared_part, toml_of),
    *(
        of_file(
            *(f"mesh {kind}", f"m.{kind.partition('_')[0]}", BUILD, mesh(kind)),
            text_of if kind in TEXT_MESHES else bytes_of,
        )
        for kind in ("stl", "ply", "glb", *TEXT_MESHES)
    ),
    of_file("capture.toml", "capture/capture.toml", DECODE, scanned, toml_of),
    of_file("rig.yaml", "capture/rig.yaml", DECODE, scanned, text_of),
    *(
        of_file(
            *(f"rig of {name}", files[0], f"rig show {' '.join(files)} {STATED}"),
            calibration(name),
            bytes_of if name == "bouguet" else text_of,
            0.5,
        )
        for name, files in CALIBRATIONS.items()
    ),
    of_file("frame", "capture/frames/002.png", DECODE, scanned, bytes_of),
    *(
        row
        for kind, (_, path) in KEPT.items()
        for row in (
            of_file(f"frame {kind}", f"capture/{path}", DECODE, kept(kind), bytes_of, 0.5),
            of_file(f"frames {kind}", "capture/capture.toml", DECODE, kept(kind), toml_of, 0.3),
        )
    ),
    *(
        of_file(
            f"photograph {kind}",
            f"photos/1.{kind}",
            "fuse photos --out out/a.png",
            photographs(kind),
            bytes_of,
        )
        for kind in ("png", "tiff", "jpg")
    ),
    of_file(
        "stack.toml",
        "stack/stack.toml",
        "fuse stack --method modulation --out out",
        stack,
        toml_of,
        0.5,
    ),
    of_file(
        *("model.json", "model.json"),
        "calibrate apply model.json capture --out out/c.ply",
        *(fitted, json_of),
    ),
    of_file(
        "points", "points.csv", "calibrate fit points.csv --out out/m.json", points, cells_of, 0.5
    ),
    of_file(
        *("points fitted together", "points.csv"),
        "calibrate fit points.csv --multivariate --axes uv --out out/m.json",
        *(points, cells_of, 0.5),
    ),
    of_file(
        *("positions", "pos.csv"),
        "register v0.ply v1.ply --positions pos.csv --out out",
        *(views, cells_of),
    ),
    of_file(
        *("view", "v1.ply"),
        "register v0.ply v1.ply --positions pos.csv --out out",
        *(views, bytes_of),
    ),
    of_file("pattern set", "set.toml", "patterns show set.toml --json", pattern_sets, toml_of),
    of_file(
        *("picture of a pattern set", "pictures/3.png"),
        "patterns show pictures --json",
        *(pattern_sets, bytes_of),
    ),
    of_file(
        *("module of a pattern set", "mine.py"),
        "patterns show mine.py:SET --allow-modules --json",
        *(pattern_sets, text_of, 0.5),
    ),
    of_file("hardware", "hw.toml", "design evaluate hw.toml table.csv --json", hardware, toml_of),
    of_file(
        *("configurations", "table.csv"),
        "design evaluate hw.toml table.csv --json",
        *(hardware, cells_of, 0.5),
    ),
    of_file(
        *("front", "front.npz"),
        "design rig hw.toml --start front.npz --evaluations 5 --out out",
        *(front, arrays_of, 0.3),
    ),
    of_file(
        *("noise table", "noise.csv"),
        "design patterns --width-px 64 --noise-table noise.csv --json",
        *(noise_table, cells_of),
    ),
    of_file("claims", "a.claims.toml", "check a.claims.toml", claims, toml_of, 0.5),
    of_file("baseline", "b.json", "check a.claims.toml --baseline b.json", baseline, json_of, 0.3),
    of_file(
        *("data set's specification", "tiny.toml"),
        "dataset make tiny.toml --count 1 --workers 0 --out out",
        *(dataset_spec, toml_of, 0.3),
    ),
    of_dataset("data set's manifest", "data/*.json", "dataset info data", 1.0),
    of_dataset("data set's index", "data/*.parquet", "dataset info data", 0.5),
    of_dataset("shard", "data/**/*.tar", "dataset verify data", 0.5),
    of_dataset("shard exported", "data/**/*.tar", "dataset export data --out out", 0.3),
    of_file(
        *("light transport", "capture/transport.npz", "", scanned, arrays_of, 0.5),
        lambda folder: LightTransport.load(folder / "capture/transport.npz"),
    ),
    of_file(
        *("ground truth", "capture/truth.exr", "", truth, bytes_of, 0.5),
        lambda folder: GroundTruth.load(folder / "capture/truth.exr"),
    ),
    Row("command line", everything, command_line, 3.0),
]
