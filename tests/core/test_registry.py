"""Registries: rows, entry points, modules; what is refused says why in one line."""

from __future__ import annotations

import hashlib
import sys
import types
from importlib.metadata import EntryPoint

import pytest

from slbench.core import modules, registry
from slbench.core.errors import InputError
from slbench.core.io import provenance
from slbench.core.registry import Registry

HEAD = "from tests_registry_numbers import NUMBERS\n"


@pytest.fixture(autouse=True)
def numbers(monkeypatch):
    """Modules of the tests find the registry under a name that can be imported."""
    shelf = types.ModuleType("tests_registry_numbers")
    shelf.NUMBERS = Registry("number", "slbench.tests_numbers", {"pi": "math:pi"}, "builtins:float")
    monkeypatch.setitem(sys.modules, "tests_registry_numbers", shelf)
    monkeypatch.setattr(modules, "_run", {})
    return shelf.NUMBERS


def run(folder, text, allowed=True, name="mine.py"):
    (folder / name).write_text(HEAD + text)
    return modules.load_modules([name], folder, allowed, "scene.toml: modules")


def refused(*arguments, **options):
    with pytest.raises(InputError) as caught:
        run(*arguments, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_module_adds_a_row_and_is_known_by_path_and_hash(tmp_path, numbers):
    found = run(tmp_path, "NUMBERS.add('e', 2.718)\n")
    assert numbers.get("e") == 2.718
    assert numbers.names() == ["pi", "e"]
    assert numbers.origin("e") == str(tmp_path / "mine.py")
    digest = hashlib.sha256((tmp_path / "mine.py").read_bytes()).hexdigest()
    assert found == ({"path": "mine.py", "sha256": digest},)
    written = provenance({}, None)["extensions"]["modules"]
    assert written == [{"path": str(tmp_path / "mine.py"), "sha256": digest}]


def test_a_module_is_not_run_unless_allowed(tmp_path, numbers):
    message = refused(tmp_path, "NUMBERS.add('e', 2.718)\n", allowed=False)
    assert message.startswith("scene.toml: modules: expected --allow-modules")
    assert "e" not in numbers


@pytest.mark.parametrize("name", ["../mine.py", "/tmp/mine.py", "mine.txt", ""])
def test_modules_stand_beside_the_file(tmp_path, name):
    (tmp_path / "mine.txt").touch()
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "mine.py").write_text("raise SystemExit")
    with pytest.raises(InputError, match=r"^scene.toml: modules: expected "):
        modules.load_modules([name], inner, True, "scene.toml: modules")


@pytest.mark.parametrize("names", ["mine.py", [1], {"mine.py": 1}, 3])
def test_modules_are_a_list_of_names(tmp_path, names):
    with pytest.raises(InputError, match="a list of Python files"):
        modules.load_modules(names, tmp_path, True, "scene.toml: modules")


def test_a_module_that_fails_leaves_nothing(tmp_path, numbers):
    message = refused(tmp_path, "NUMBERS.add('e', 2.718)\n1 / 0\n")
    assert message.startswith("scene.toml: modules: mine.py: expected a module that runs, got")
    assert "ZeroDivisionError" in message
    assert "e" not in numbers
    run(tmp_path, "NUMBERS.add('e', 2.718)\n")
    assert "e" in numbers


def test_a_changed_module_replaces_its_own_rows(tmp_path, numbers):
    run(tmp_path, "NUMBERS.add('e', 2.7)\n")
    run(tmp_path, "NUMBERS.add('e', 2.718)\n")
    assert numbers.get("e") == 2.718
    with pytest.raises(InputError):
        run(tmp_path, "NUMBERS.add('e', 3.0)\n1 / 0\n")
    assert numbers.get("e") == 2.718


def test_the_same_content_is_run_once(tmp_path, numbers):
    run(tmp_path, "NUMBERS.add('e', 2.7)\n")
    run(tmp_path, "NUMBERS.add('e', 2.7)\n", name="again.py")
    assert numbers.origin("e") == str(tmp_path / "mine.py")


@pytest.mark.parametrize("name", ["pi", "e"])
def test_names_that_are_taken_are_refused(tmp_path, name):
    run(tmp_path, "NUMBERS.add('e', 2.7)\n")
    message = refused(tmp_path, f"NUMBERS.add({name!r}, 1.5)\n", name="other.py")
    owner = {"pi": "slbench", "e": str(tmp_path / "mine.py")}[name]
    assert message == (
        f"scene.toml: modules: other.py: number {name!r}: expected a name that is not taken, "
        f"got one of {owner}"
    )


def test_rows_of_another_kind_are_refused(tmp_path):
    message = refused(tmp_path, "NUMBERS.add('e', 'text')\n")
    assert message.endswith("number 'e': expected a builtins.float, got str")


@pytest.mark.parametrize("name", [3, None, ""])
def test_a_row_has_a_name(name, numbers):
    with pytest.raises(InputError, match="expected a name"):
        numbers.add(name, 1.5)
    assert numbers.names() == ["pi"]


def test_a_module_neither_ends_the_program_nor_speaks_in_its_results(tmp_path, capsys):
    assert "expected a module that runs, got SystemExit" in refused(tmp_path, "raise SystemExit(0)")
    run(tmp_path, "print('hello')")
    assert capsys.readouterr() == ("", "hello\n")


def test_an_installed_package_neither_ends_the_program_nor_speaks_in_its_results(
    tmp_path, numbers, monkeypatch, capsys
):
    (tmp_path / "ends_when_imported.py").write_text("print('hello')\nraise SystemExit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    point = EntryPoint("e", "ends_when_imported:E", numbers.group)
    monkeypatch.setattr(registry, "_installed", lambda group: {"e": [point]})
    with pytest.raises(InputError, match="to be importable, got SystemExit"):
        numbers.get("e")
    assert capsys.readouterr() == ("", "hello\n")
