"""The frame: who may import what, pinned versions, the changelog."""

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


def loaded_by(*modules: str, blocked: tuple[str, ...] = ()) -> set[str]:
    """Modules that a fresh interpreter has loaded after importing some."""
    code = (
        "import importlib, sys\n"
        f"for name in {blocked!r}:\n    sys.modules[name] = None\n"
        f"for name in {modules!r}:\n    importlib.import_module(name)\n"
        "print(*sys.modules)\n"
    )
    child = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert child.returncode == 0, child.stderr
    return set(child.stdout.split())


def modules_of(package: str) -> list[str]:
    """Every module of a package, `__main__` left out: run as a program, it does not come back."""
    folder = ROOT / package.replace(".", "/")
    names = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in sorted(folder.rglob("*.py"))
    ]
    return [name for name in names if not name.endswith("__main__")]


#: What works on photographs alone, and knows of no simulation.
REAL = ("core", "rig", "patterns", "capture", "cloud", "calibration")


class TestImports:
    """Who may import whom is held by import-linter (`make lint`); this is what is loaded."""

    def test_nothing_but_render_needs_mitsuba_to_be_imported(self):
        # Under render, the backend and what finds it must be importable without it too.
        render = "slbench.simulate.render"
        free = [render, f"{render}.backend.choice", f"{render}.backend.llvm"]
        free += [name for name in modules_of("slbench") if not name.startswith(render)]
        loaded_by(*free, blocked=("mitsuba", "drjit"))

    def test_importing_slbench_loads_nothing_heavy(self):
        heavy = {"mitsuba", "drjit", "numba", "cv2", "trimesh", "scipy", "matplotlib"}
        assert loaded_by("slbench", "slbench.simulate.render") & heavy == set()

    def test_real_data_need_no_simulator(self):
        modules = [name for part in REAL for name in modules_of(f"slbench.{part}")]
        loaded = loaded_by(*modules)
        foreign = {"mitsuba", "drjit", "matplotlib", "plotly", "manifold3d", "trimesh"}
        foreign |= {f"slbench.{name}" for name in ("scene", "objects", "simulate", "detector")}
        assert loaded & foreign == set()


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
