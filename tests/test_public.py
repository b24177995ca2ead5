"""The public names: those of the stubs, unchanged unless somebody means it; values show briefly."""

import ast
import importlib
import inspect
import pkgutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from calibration_data import rig_points
from datasets_small import result_of, write_dataset
from public_names import LIST, PACKAGES, described

import slbench as sl
from slbench.core.show.display import brief
from slbench.core.show.document import Table

#: Needs a library that is not among the dependencies.
OPTIONAL = "slbench.datasets.read.torch_adaptor"
LAZY = [name for name, one in PACKAGES.items() if Path(one.__file__).with_suffix(".pyi").exists()]


def stub_names(package):
    """Return the names of a package's stub and the module that each comes from."""
    tree = ast.parse(Path(package.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                # Under another name it would be public for type checkers alone.
                assert alias.asname == alias.name
                yield alias.name, node.module


def test_the_public_names_are_those_of_the_list():
    listed = LIST.read_text(encoding="utf-8").splitlines()
    now = described()
    gone, new = sorted(set(listed) - set(now)), sorted(set(now) - set(listed))
    assert (gone, new) == ([], []), "meant? then run: python tests/helpers/public_names.py"
    assert listed == now


def test_the_flat_namespace_stays_small():
    flat = [name for name in sl.__all__ if not isinstance(getattr(sl, name), ModuleType)]
    assert 40 <= len(flat) <= 66


@pytest.fixture(scope="module")
def everything():
    """Import every module, each of which becomes an attribute of its package."""
    for module in pkgutil.walk_packages(sl.__path__, "slbench."):
        if not module.name.endswith("__main__") and module.name != OPTIONAL:
            importlib.import_module(module.name)


@pytest.mark.usefixtures("everything")
@pytest.mark.parametrize("name", LAZY)
def test_stub_and_package_agree_whatever_is_imported(name):
    package = PACKAGES[name]
    names = dict(stub_names(package))
    assert sorted(names) == sorted(package.__all__)
    for public, module in names.items():
        if module is None:
            expected = importlib.import_module(f"{name}.{public}")
        else:
            expected = getattr(importlib.import_module(f"{name}.{module}"), public)
        assert getattr(package, public) is expected, public


@pytest.mark.parametrize("name", LAZY)
def test_no_public_name_is_that_of_another_module(name):
    package = PACKAGES[name]
    modules = {found.name for found in pkgutil.iter_modules(package.__path__)}
    from_elsewhere = {public for public, module in stub_names(package) if module is not None}
    assert not modules & from_elsewhere


# -- how values show themselves -----------------------------------------------------------------


@pytest.fixture(scope="module")
def values(tmp_path_factory):
    """Return a real instance of every public type that writes its own text."""
    scan = result_of(1)
    scene = scan.scene
    artefact = scene.objects[0].artefact
    stack = sl.FocusStack([scan.capture] * 3, sl.capture.Focus({"camera": (400.0,) * 3}))
    ball = sl.objects.load_artefact("ball-bar")
    sets = ["1,8", "1,4", "gray", "1,2,4", "1,3,9", "1,8@4"]
    found = [
        scan,
        *(scan.transport, scan.truth, scan.capture, scan.phase, scan.cloud, scan.score),
        *(scene, scene.objects[0], scene.objects[0].material, scene.detector),
        sl.scene.environment_of("window", irradiance_w_per_mm2=1e-5),
        *(sl.scene.BitPlanes(periods=1.5), sl.scene.Trigger(lost=(3,)), sl.scene.Drift(change=0.1)),
        *(scene.light, scene.exposure, scene.sequence, sl.scene.Status.LIT),
        sl.calibration.FreeBoard(kind="chequerboard", columns=9, rows=7, pitch_mm=5.0),
        *(scene.rig, scene.rig.camera, scene.rig.projector, scene.rig.camera.pose, scene.rig.only),
        *(scene.rig.camera.lens, sl.DesignVariables(500.0, -100.0, 0.0, 0.0, 0.1, 0.1)),
        *(
            artefact,
            artefact.mesh,
            artefact.features[0],
            ball,
            ball.spheres[0],
            sl.objects.artefacts.get("plane"),
        ),
        sl.capture.Captures({scan.capture.pair: scan.capture}, scene.rig),
        sl.cloud.triangulate_jointly(scene.rig, {scan.capture.pair: scan.phase}),
        sl.simulate.scan_rig(scene),
        *(stack, stack.focus, scan.capture.noise, sl.patterns.Rule.ORDER),
        *(sl.Fringes(8), sl.GrayCode(), sl.Flat(1.0), scene.sequence.frames()[0]),
        scene.with_patterns("white+black+gray+1,2,4,8,16,32,64@8", axes="uv").sequence,
        *(sl.patterns.read_patterns("1,8", (64, 48)), sl.patterns.Response(2.2)),
        *(kind([1.0, 2.0, 3.0], [0.0, 0.0, 1.0], 5.0, 0.4) for kind in elements()),
        sl.cloud.registration.Overlap(0, 1, 1000, 0.5, 0.001, 0.0005, 6),
        sl.select_models(rig_points(200)).model,
        sl.compare(scene, sets, repeats=2, transports=[scan.transport], truth=scan.truth),
        sl.error_budget(scene, repeats=2),
        *uncertain(scene),
        sl.bench.cloud_terms([sl.cloud.MeasuredCloud(flat_cloud())], patch_mm=10.0),
        *accepted(),
        sl.diagnose_cloud(flat_cloud()),
        sl.score_cloud(flat_cloud_on_plane(), artefact="plane"),
        sl.cloud.MeasuredCloud(flat_cloud(), scalars={"sigma": np.full(1200, 0.01)}),
        sl.open_dataset(write_dataset(tmp_path_factory.mktemp("small"))),
        sl.simulate.render.current(),
        sl.scene.Colour(),
        sl.simulate.ColourTransport.of([scan.transport] * 3, sl.scene.Colour()),
        small_twin(),
    ]
    return found


def elements():
    return (sl.cloud.fits.Element, *sl.cloud.fits.elements.values())


def uncertain(scene):
    """Return the uncertainty budget of a face of a scene."""
    faces = (one for one in sl.bench.claims.quantities.features_of(scene) if one.kind == "plane")
    name = f"plane[{next(faces).label}].std_mm"
    yield sl.bench.uncertainty_budget(scene, [name], draws=100)


def accepted():
    """Return a plate's certificate, a limit, and its acceptance."""
    from slbench.bench.accept.acceptance import assembled
    from slbench.bench.accept.evaluate import Place, measured_place
    from slbench.bench.accept.surfaces import Points

    plate, limit = sl.bench.Standard("plane", size_mm=(40.0, 30.0)), sl.bench.Limit(50.0, 20.0)
    place = measured_place(Place("plane 1", plate), [[Points(flat_cloud())]])
    return plate, limit, assembled("flat", [place], limits={"flatness": limit})


def flat_cloud():
    rows, columns = np.indices((30, 40))
    heights = np.random.default_rng(0).normal(0.0, 0.01, rows.size)
    return np.column_stack([columns.ravel(), rows.ravel(), heights])


def flat_cloud_on_plane():
    """Return points of the shipped plane, where it is."""
    places = np.random.default_rng(0).uniform(-20.0, 20.0, (500, 2))
    return sl.cloud.MeasuredCloud(np.column_stack((places, np.zeros(500))))


def small_twin():
    """Return the twin of a scan of few pixels."""
    photographed = sl.scan(sl.load_scene("plane").coarser(8, 16), score=False).capture
    return sl.twin.make_twin(photographed, [sl.twin.TwinObject(shape="plane")], samples=4)


def own_texts():
    """Return the public types that do not leave their text to :func:`brief`."""
    for package in PACKAGES.values():
        for name in getattr(package, "__all__", ()):
            kind = getattr(package, name)
            if not inspect.isclass(kind) or not kind.__module__.startswith("slbench"):
                continue
            abstract = getattr(kind, "_is_protocol", False) or issubclass(kind, Exception)
            if not abstract and kind.__repr__ not in (brief, object.__repr__):
                yield kind


def test_every_value_shows_itself_in_a_few_lines(values):
    shown = {type(value) for value in values}
    missing = set(own_texts()) - shown - {sl.rig.Device}  # a camera or a projector
    assert not missing, "add one to the fixture"
    for value in values:
        text = repr(value)
        assert len(text) <= 600, text
        assert len(text.splitlines()) <= 8, text
        assert "array(" not in text


def test_figures_of_the_texts_are_those_of_the_value(values):
    scan = values[0]
    assert f"{len(scan.cloud)} points" in repr(scan)
    assert f"{len(scan.cloud)} points" in repr(scan.cloud)
    assert f"{scan.capture.frames.shape[0]} frames 64 x 48 px" in repr(scan.capture)
    assert f"{100 * np.mean(scan.phase.mask):.1f} % measured" in repr(scan.phase)
    assert f"{100 * np.mean(scan.truth.lit):.1f} % lit" in repr(scan.truth)
    low, high = scan.cloud.points[:, 2].min(), scan.cloud.points[:, 2].max()
    assert f"z {low:.4g} to {high:.4g} mm" in repr(scan.cloud)


def test_tables_of_a_notebook_are_escaped(values):
    shown = [value for value in values if hasattr(value, "_repr_html_")]
    assert {type(v) for v in shown} >= {sl.Scan, sl.Score, sl.Comparison, sl.PatternSequence}
    for value in shown:
        html = value._repr_html_()
        assert html.count("<tr>") == html.count("</tr>") > 1
    table = Table("<i>", ("a & b",), (("<script>",),), "x < y")
    html = table._repr_html_()
    assert "&lt;script&gt;" in html
    assert "a &amp; b" in html
    assert "<i>" not in html
    assert "x &lt; y" in html
