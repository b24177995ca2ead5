"""The frame: who may import what, pinned versions, the changelog."""

import ast
import graphlib
import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import slbench

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "slbench"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

# The whole package in order: a unit imports only from those before it.
STREAM = (
    "errors",
    "io",
    "resources",
    "validation",
    "rig",
    "patterns",
    "fusion",
    "objects",
    "materials",
    "detector",
    "scene",
    "scenetables",
    "scenefile",
    "transport",
    "truth",
    "render",
    "capture",
    "focusstack",
    "fusionscore",
    "reconstruct",
    "registration",
    "features",
    "score",
    "figures",
    "scan",
    "summary",
    "scanfolder",
    "calibration",
    "design",
    "report",
    "bench",
    "datasets",
    "sheets",
    "doctor",
    "cli",
)


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imported_names(module: str) -> set[str]:
    """Every module that a module names in an import, wherever the import stands.

    Imports for type checking only are left out: they do not happen.
    """
    tree = ast.parse(MODULES[module].read_text())
    checking_only = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for statement in node.body
        for inner in ast.walk(statement)
    }
    names = set()
    for node in ast.walk(tree):
        if node in checking_only:
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                is_package = MODULES[module].name == "__init__.py"
                above = module.split(".")[: None if is_package else -1]
                above = above[: len(above) - node.level + 1]
                base = ".".join([*above, *filter(None, [base])])
            # `from package import name`: the name may be a module, else it is the package's.
            for alias in node.names:
                longer = f"{base}.{alias.name}"
                names.add(longer if longer in MODULES else base)
        elif (
            isinstance(node, ast.Call)
            and ast.unparse(node.func).endswith(("import_module", "__import__"))
            and isinstance(node.args[0], ast.Constant)
        ):
            names.add(node.args[0].value)
    return names


def own_imports(module: str) -> set[str]:
    return {name for name in imported_names(module) if name in MODULES and name != module}


def unit(module: str) -> str:
    """The top-level module or subpackage that a module belongs to."""
    return [*module.split("."), ""][1]


def unit_imports() -> dict[str, set[str]]:
    graph: dict[str, set[str]] = {}
    for module in MODULES:
        graph.setdefault(unit(module), set()).update(unit(name) for name in own_imports(module))
    return {name: others - {name} for name, others in graph.items()}


def assert_acyclic(graph: dict[str, set[str]]) -> None:
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail("a circle of imports: " + " <- ".join(error.args[1]))


class TestImports:
    def test_the_walk_sees_imports(self):
        # Guards the tests below, which an empty answer would satisfy.
        assert "slbench.core.errors" in own_imports("slbench.simulate.render.backend.llvm")
        assert "mitsuba" in imported_names("slbench.simulate.render.backend.choice")
        assert "render" in unit_imports()["doctor"]

    def test_every_unit_has_its_place(self):
        # The package itself holds the version alone.
        assert set(unit_imports()) - {""} == set(STREAM)

    def test_only_render_imports_mitsuba(self):
        offenders = {
            module
            for module in MODULES
            if unit(module) != "render"
            and {name.split(".")[0] for name in imported_names(module)} & {"mitsuba", "drjit"}
        }
        assert offenders == set()

    def test_modules_do_not_import_in_a_circle(self):
        assert_acyclic({module: own_imports(module) for module in MODULES})

    def test_units_do_not_import_in_a_circle(self):
        assert_acyclic(unit_imports())

    def test_the_main_stream_runs_one_way(self):
        rank = {name: position for position, name in enumerate(STREAM)}
        against = {
            f"{importer} imports {imported}"
            for importer, others in unit_imports().items()
            for imported in others
            if importer in rank and imported in rank and rank[imported] > rank[importer]
        }
        assert against == set()

    def test_nothing_but_render_needs_mitsuba_to_be_imported(self):
        # Under render, the backend and what finds it must be importable without it too.
        free = [
            "slbench.simulate.render",
            "slbench.simulate.render.backend.choice",
            "slbench.simulate.render.backend.llvm",
        ]
        free += [module for module in MODULES if unit(module) != "render"]
        # Run as a program, __main__ does not come back.
        free = [module for module in free if not module.endswith("__main__")]
        code = (
            "import importlib, sys\n"
            "sys.modules['mitsuba'] = sys.modules['drjit'] = None\n"
            f"for name in {free!r}:\n"
            "    importlib.import_module(name)\n"
        )
        child = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
        )
        assert child.returncode == 0, child.stderr

    def test_importing_slbench_loads_nothing_heavy(self):
        code = (
            "import slbench, slbench.simulate.render, sys\n"
            "print(sorted({'mitsuba', 'drjit', 'numba', 'cv2', 'trimesh'} & set(sys.modules)))\n"
        )
        child = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
        )
        assert child.stdout == "[]\n"


def normalised(name: str) -> str:
    """A distribution's name as package indexes compare it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def requirement_names(requirements: list[str]) -> set[str]:
    names = (re.match(r"[A-Za-z0-9._-]+", requirement)[0] for requirement in requirements)
    return {normalised(name) for name in names} - {"slbench"}


class TestPins:
    lines = (ROOT / "constraints.txt").read_text().splitlines()

    def test_every_line_is_a_plain_pin(self):
        pin = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*==[0-9][0-9A-Za-z.]*")
        assert [line for line in self.lines if not pin.fullmatch(line)] == []

    def test_sorted_and_once_each(self):
        names = [normalised(line.split("==")[0]) for line in self.lines]
        assert names == sorted(set(names))

    def test_every_direct_dependency_is_pinned(self):
        wanted = list(PROJECT["dependencies"])
        for extra in PROJECT["optional-dependencies"].values():
            wanted += extra
        pinned = {normalised(line.split("==")[0]) for line in self.lines}
        assert requirement_names(wanted) - pinned == set()

    def test_mitsuba_and_drjit_fit_together(self):
        # Mitsuba refuses every Dr.Jit but one, and says which in its metadata.
        pins = dict(line.split("==") for line in self.lines)
        if importlib.metadata.version("mitsuba") != pins["mitsuba"]:
            pytest.skip("another Mitsuba than the pinned one is installed")
        assert f"drjit=={pins['drjit']}" in importlib.metadata.requires("mitsuba")


class TestRelease:
    def test_the_changelog_knows_the_version(self):
        text = (ROOT / "CHANGELOG.md").read_text()
        assert "## [Unreleased]" in text
        assert slbench.__version__ in text

    def test_the_licence_is_the_one_declared(self):
        text = (ROOT / "LICENSE").read_text()
        assert text.startswith("MIT License")
        assert f"Copyright (c) 2026 {PROJECT['authors'][0]['name']}" in text
