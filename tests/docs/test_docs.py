"""The documentation holds: links, anchors, commands, snippets, formulas, errata, and the build."""

import ast
import functools
import importlib.util
import itertools
import json
import os
import re
import shlex
import subprocess
import sys
from importlib import metadata

import numpy as np
import pytest
from browsers import chromium
from pages import ALL, DOCS, FENCE, PAGES, ROOT, named_commands, shown_commands, text_of

from slbench.cli import app
from slbench.core import resources
from slbench.design.fringes import design
from slbench.design.fringes.noise import PhaseNoise
from slbench.design.fringes.unwrapping import ideal_phases
from slbench.design.rig.hardware import read_configurations

IDS = [str(path.relative_to(ROOT)) for path in ALL]

LINK = re.compile(r"!?\[[^\]]*\]\(([^()\s]+)\)")


def prose(path):
    """Return a page without fenced blocks and code, where brackets mean something else."""
    return re.sub(r"`[^`\n]*`", "", FENCE.sub("", text_of(path)))


@functools.cache
def anchors(path):
    """Return the anchors of a page's headings, as GitHub makes them and the site does."""
    found = set()
    for heading in re.findall(r"^#+ (.+)$", FENCE.sub("", text_of(path)), re.MULTILINE):
        words = re.sub(r"[^\w\- ]", "", re.sub(r"[`*]", "", heading).lower())
        found.add(words.strip().replace(" ", "-"))
    return found


# -- links and pages ---------------------------------------------------------------------------


@pytest.mark.parametrize("path", ALL, ids=IDS)
def test_links_and_anchors_lead_somewhere(path):
    for target in LINK.findall(prose(path)):
        assert "://" not in target or target.startswith("https://"), target
        if "://" in target:
            continue  # nothing outside is looked up
        name, _, anchor = target.partition("#")
        aim = (path.parent / name).resolve() if name else path
        # The site can link to files alone; the README is not on it.
        assert aim.is_file() or (path.name == "README.md" and aim.is_dir()), target
        if anchor:
            assert anchor in anchors(aim), f"{path.name}: {target}"


def test_every_page_is_in_the_contents_once():
    contents = [
        line.strip()
        for language, body in ((m[2], m[3]) for m in FENCE.finditer(text_of(DOCS / "index.md")))
        if language == "{toctree}"
        for line in body.splitlines()
        if line.strip() and not line.startswith(":")
    ]
    pages = [str(path.relative_to(DOCS).with_suffix("")) for path in PAGES if path.stem != "index"]
    assert sorted(contents) == sorted(pages)


def test_every_picture_is_used_and_light():
    used = {
        (path.parent / target).resolve()
        for path in ALL
        for target in re.findall(r"!\[[^\]]*\]\(([^()\s]+)\)", text_of(path))
    }
    ours = {image.resolve() for image in (DOCS / "images").iterdir()}
    assert ours <= used  # others are those of results/
    heavy = {image.name: image.stat().st_size for image in ours if image.stat().st_size > 200_000}
    assert not heavy


@pytest.mark.parametrize("path", ALL, ids=IDS)
def test_tests_that_are_named_exist(path):
    tests = ROOT / "tests"
    for named in re.findall(r"`((?:tests/)?(?:\w+/)*test_\w+\.py)`", text_of(path)):
        assert (tests / named.removeprefix("tests/")).exists(), named


# -- commands ----------------------------------------------------------------------------------


def commands(path):
    """Return the command lines of a page, those within sentences too."""
    return shown_commands(path) + named_commands(path)


@functools.cache
def command_tree():
    return app


def parse(line):
    """Walk the command tree along a line; raise ValueError where it does not lead."""
    words = shlex.split(line, comments=True)[1:]
    command = command_tree()
    while words and hasattr(command, "commands"):
        name = words.pop(0)
        if name.startswith("-"):
            raise ValueError(f"{name} before a command")
        # "calibrate run | fit | apply", "bench ch6|ch7": the first stands for all.
        name = name.split("|")[0].rstrip(",")
        if name.isupper() or name == "...":
            return
        if name not in command.commands:
            raise ValueError(f"no command {name}")
        command = command.commands[name]
    options = {
        spelling: option
        for option in command.params
        for spelling in (*option.opts, *option.secondary_opts)
        if spelling.startswith("-")
    }
    words = [word for word in words if word not in ("[", "]", "|")]
    for word in words:
        name = word.strip("[]").partition("=")[0]
        if name.startswith("--") and name not in options and name != "--help":
            raise ValueError(f"{command.name} has no option {name}")


@pytest.mark.parametrize("path", ALL, ids=IDS)
def test_commands_and_their_options_exist(path):
    for line in commands(path):
        try:
            parse(line)
        except ValueError as error:
            pytest.fail(f"{path.name}: {line}: {error}")


def test_the_command_line_reference_is_current():
    name, _, version = next(
        line.partition("==")
        for line in text_of(ROOT / "constraints.txt").splitlines()
        if line.startswith("typer==")
    )
    if metadata.version(name) != version:
        pytest.skip(f"the page is written with {name} {version}, which words its types itself")
    specification = importlib.util.spec_from_file_location("cli_page", DOCS / "generate_cli.py")
    generator = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(generator)
    assert text_of(generator.PAGE) == generator.page(), "run python docs/generate_cli.py"


def test_the_parser_of_commands_sees_mistakes():
    parse("slbench scan step-block --preview --out x")
    for line in ("slbench scam x", "slbench scan x --previw", "slbench design rigg x"):
        with pytest.raises(ValueError, match="no "):
            parse(line)
    assert len(list(commands(DOCS / "how-to" / "design-rig.md"))) > 5


# -- snippets ----------------------------------------------------------------------------------

SNIPPETS = [
    pytest.param(path, m[3], id=f"{path.name}-{k}")
    for path in ALL
    for k, m in enumerate(m for m in FENCE.finditer(text_of(path)) if m[2] == "python")
]


@pytest.mark.parametrize(("path", "code"), SNIPPETS)
def test_python_snippets_compile_and_import_what_exists(path, code):
    tree = ast.parse(code)
    compile(tree, path.name, "exec")
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("slbench"):
            module = importlib.import_module(node.module)
            for alias in node.names:
                if not hasattr(module, alias.name):
                    importlib.import_module(f"{node.module}.{alias.name}")


def test_the_snippet_of_designing_patterns_runs_and_gives_its_numbers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = (p.values[1] for p in SNIPPETS if p.values[0].name == "design-patterns.md")
    scope = {}
    exec(compile(code, "design-patterns.md", "exec"), scope)
    # The numbers of the snippet's own comments.
    assert scope["design"].fringes == (1, 10, 80)
    assert scope["design"].sigma_px == pytest.approx(0.0286, abs=1e-4)
    assert scope["predict"](400, scope["noise"], (1, 20)).sigma_px == pytest.approx(0.137, abs=5e-4)


def test_the_snippet_of_the_readme_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = (p.values[1] for p in SNIPPETS if p.values[0].name == "README.md")
    assert "import slbench as sl" in code
    scope = {}
    exec(compile(code, "README.md", "exec"), scope)
    for step in scope["result"].score.steps:
        assert step.measured_mm == pytest.approx(step.nominal_mm, abs=0.02)  # a preview
    assert scope["image"].shape == (1, 240, 320)
    assert len(scope["cloud"]) == len(scope["result"].cloud)
    assert (tmp_path / "block.png").stat().st_size > 10_000


def test_the_code_and_the_decoder_of_the_page_are_compared(tmp_path):
    """The page's file and its snippet run, and what the page says of them holds."""
    code, snippet = (p.values[1] for p in SNIPPETS if p.values[0].name == "own-codes.md")
    (tmp_path / "mine.py").write_text(code)
    (family,) = [n for n in ast.parse(code).body if isinstance(n, ast.ClassDef)]
    assert family.end_lineno - family.lineno < 30
    values = "(one.name, one.std_median_mm, one.bound_share, one.completeness)"
    (tmp_path / "run.py").write_text(
        f"import json\n{snippet}\nprint(json.dumps([{values} for one in found.sets]))\n"
    )
    # In a process of its own: a family's name is taken once it is registered.
    paths = os.pathsep.join([str(ROOT), *sys.path])
    run = subprocess.run(
        [sys.executable, "run.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
    )
    triangles, own, usual = json.loads(run.stdout.splitlines()[-1])
    assert (triangles[0], own[0], usual[0]) == ("(triangles)", "my decoder", "1,25")
    # As good as the package's own decoder, on the same pixels; sinusoids beat triangles.
    assert own[1] == pytest.approx(usual[1], rel=0.015)
    assert own[2] == pytest.approx(usual[2], rel=0.03)
    assert triangles[1] > 1.05 * usual[1]
    assert triangles[2] < 0.9 * usual[2]
    assert min(one[3] for one in (triangles, own, usual)) > 0.95


# -- formulas and the site ---------------------------------------------------------------------


def formulas(path):
    """Return the formulas of a page, as the site's parser finds them."""
    text = re.sub(r"`[^`\n]*`", "", FENCE.sub("", text_of(path)))
    blocks = re.findall(r"\$\$(.*?)\$\$", text, re.DOTALL)
    return blocks + re.findall(
        r"\$([^$\n]+?(?:\n[^$\n]+?)?)\$", re.sub(r"\$\$.*?\$\$", "", text, flags=re.S)
    )


def test_formulas_become_mathml_whole():
    converter = pytest.importorskip("latex2mathml.converter", reason="needs the docs extra")
    count = 0
    for tex in itertools.chain.from_iterable(map(formulas, PAGES)):
        markup = converter.convert(tex.strip())
        # What it does not know it leaves as TeX.
        text = re.sub(r"<[^>]*>", "", markup)
        assert "\\" not in text, tex
        assert "&amp;" not in text, tex
        count += 1
    assert count > 100


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site as `make docs` does; return its folder."""
    for name in ("sphinx", "myst_parser", "furo", "latex2mathml"):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"needs the docs extra: {name} is not installed")
    folder = tmp_path_factory.mktemp("docs")
    build = [sys.executable, "-m", "sphinx", "-b", "html", "-n", "-W", "--keep-going", "-q"]
    done = subprocess.run(
        [*build, "-d", folder / "cache", DOCS, folder / "site"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return folder / "site"


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_needs_no_network(site):
    for path in PAGES:
        html = (site / path.relative_to(DOCS)).with_suffix(".html").read_text(encoding="utf-8")
        # No script, style, picture or font from elsewhere.
        assert not re.search(r"""(?:src|srcset)=["']?(?:https?:)?//""", html)
        assert not re.search(r"""<link[^>]+href=["'](?:https?:)?//""", html)
    assert "<math" in (site / "explanation" / "decoding.html").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1366])
def test_no_page_scrolls_sideways(site, width):
    with chromium() as browser:
        page = browser.new_page(viewport={"width": width, "height": 900})
        asked, errors = [], []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: errors.append(str(error)))
        for file in sorted(site.rglob("*.html")):
            page.goto(file.as_uri())
            assert page.evaluate("document.documentElement.scrollWidth") <= width, file.name
    assert not errors
    assert all(url.startswith(("file:", "data:")) for url in asked)


# -- errata ------------------------------------------------------------------------------------
# What docs/study/errata.md says of the thesis's equations, computed.


def turned(alpha, beta):
    (c, s), (d, t) = ((np.cos(a), np.sin(a)) for a in (alpha, beta))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array(
        [[1, 0, 0], [0, d, -t], [0, t, d]]
    )


def test_erratum_eq_5_lacks_the_camera_s_place():
    z, w, h, length, alpha, beta = np.loadtxt(
        ROOT / "scenes" / "hardware" / "table4.csv", delimiter=",", skiprows=1
    )[4]
    axis = turned(np.radians(alpha), np.radians(beta))[:, 2]
    origin, camera = axis * z / axis[2], np.array([w, h, length])
    toward = origin - camera
    pitch = -np.arcsin(toward[1] / np.linalg.norm(toward))
    rotation = turned(np.arctan2(toward[0], toward[2]), pitch)
    sensor = rotation @ [0.0, 0.0, 16.0]  # the principal point, mm
    for through, met in ((sensor, (-955, -227)), (sensor + camera, (-246, -153))):
        ray = through - camera
        point = camera + ray * (z - camera[2]) / ray[2]
        assert point[:2] == pytest.approx(met, abs=0.5)
    # Counted from the corner, eq. 8, the middle of the sensor is off the axis by half of it.
    corner = rotation @ [7.4e-3 * 320, 7.4e-3 * 240, 16.0]  # 640 x 480 px
    point = camera + corner * (z - camera[2]) / corner[2]
    assert np.linalg.norm(point - origin) > 50.0


def test_erratum_eq_31_with_and_without_the_square(monkeypatch):
    def unsquared(surface, spacing):
        rows, columns = np.gradient(surface, spacing, axis=(1, 2))
        return float(np.mean(np.sum(np.hypot(rows, columns), axis=(1, 2))))

    for roughness in (design._roughness, unsquared):
        monkeypatch.setattr(design, "_roughness", roughness)
        for width, sigma, most, options, fringes in (
            (400, 0.036, 80, {"safety": 2.0, "noise_step": 0.001}, (1, 10, 50)),
            (1024, 0.25, 16, {"safety": 1.5, "noise_step": 0.009}, (1, 2, 4, 8, 16)),
        ):
            counts = [n for n in design.candidates(width) if n <= most]
            noise = PhaseNoise.constant(sigma, counts)
            found = design.thesis_sequence(width, noise, counts, phase_model="thesis", **options)
            assert found.fringes == fringes


def test_erratum_eq_27_and_28_disagree_by_a_quarter_of_a_turn():
    relative, reference = ideal_phases(80, 400, "thesis")
    off = (80 * reference - relative) / (2 * np.pi)
    assert np.abs(off - np.rint(off)).max() == pytest.approx(0.25, abs=1e-12)


def test_erratum_eq_8_all_rays_of_a_pixel_are_one():
    k = np.arange(1, 10)
    assert not np.any(k // 640)
    assert not np.any(k // 480)
    right = {(1 + (i - 1) % 3, 1 + (i - 1) // 3) for i in range(1, 10)}
    assert right == set(itertools.product((1, 2, 3), repeat=2))


def test_erratum_eq_11_rows_of_m_2j():
    rng = np.random.default_rng(0)
    m, point = rng.normal(size=(3, 4)), rng.normal(size=4)
    point[3] = 1.0
    u, v, _ = (m @ point) / (m @ point)[2]
    for coordinate, row in ((u, m[0]), (v, m[1])):
        left = (coordinate * m[2, :3] - row[:3]) @ point[:3]
        assert left == pytest.approx(row[3] - coordinate * m[2, 3])
    printed = (v * m[2, :3] - m[0, :3]) @ point[:3]
    assert printed != pytest.approx(m[0, 3] - v * m[2, 3])


def test_erratum_eq_23_needs_other_shifts_than_eq_21():
    phase = np.linspace(0.05, 2 * np.pi - 0.05, 50)

    def of_eq_23(shifts):
        one, two, three = (np.cos(phase - shift) for shift in shifts)
        return np.arctan2(np.sqrt(3) * (one - three), 2 * two - one - three)

    def off(found, expected):
        return np.abs(np.angle(np.exp(1j * (found - expected)))).max()

    third = 2 * np.pi / 3
    assert off(of_eq_23((third, 0, -third)), phase) < 1e-12
    assert off(of_eq_23((0, third, 2 * third)), third - phase) < 1e-12
    # Without atan2, half of the phases are off by half a turn.
    tangent = np.tan(of_eq_23((third, 0, -third)))
    assert np.mean(np.abs(np.angle(np.exp(1j * (np.arctan(tangent) - phase)))) > 1) > 0.4


def test_erratum_eq_27_the_last_pixel_of_a_fringe_has_the_phase_of_the_one_before():
    period, width = 5, 400
    j = np.arange(1, width + 1)
    relative = (j % period - 1) / (period - 1)  # turns
    np.testing.assert_allclose((relative[4::5] - relative[3::5]) % 1.0, 0.0, atol=1e-12)
    # Eq. 28 in turns of 80 fringes: the two disagree by up to a fifth of a turn and more.
    apart = (width // period) * (j - 1) / (width - 1) - relative
    assert np.abs(apart - np.rint(apart)).max() > 0.2


def test_erratum_eq_35_is_singular_at_whole_coordinates():
    def matrix(u, v):
        i, j = np.floor([u, v]), np.ceil([u, v])
        return np.array(
            [[1, x, y, x * y] for x, y in itertools.product(*zip(i, j, strict=True))], float
        )

    assert np.linalg.matrix_rank(matrix(10.5, 20.5)) == 4
    assert np.linalg.matrix_rank(matrix(10.0, 20.5)) == 2


def test_erratum_table_3_beta_lies_on_the_search_s_lattice_between_10_and_15_degrees():
    table = read_configurations(
        resources.find("scenes", "hardware/macro-ch6").parent / "table4.csv"
    )
    # Ranges of table 3, with 10 to 15 deg for the last; all configurations come from two starts
    # on the diagonal by steps of 1/8 and its doubles.
    low = np.array([250, -500, -500, 0, np.deg2rad(-90), np.deg2rad(10)])
    high = np.array([1000, 0, 0, 500, 0, np.deg2rad(15)])
    scaled = (table - low) / (high - low)
    start = np.where(np.isclose(table[:, 0], 550.0), 0.4, 0.8)[:, None]
    steps = (scaled - start) * 8
    # Printed to 0.05 mm of 500 and 0.005 deg of 5: a hundredth of a step.
    assert np.abs(steps - np.rint(steps)).max() < 0.02
