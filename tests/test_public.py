"""The public names: those of the stubs, unchanged unless somebody means it.

``python tests/test_public.py`` writes the list anew after a change that is meant.
"""

import ast
import importlib
import inspect
import pkgutil
from pathlib import Path
from types import ModuleType

import pytest

import slbench as sl

LIST = Path(__file__).with_name("public-names.txt")
#: Needs a library that is not among the dependencies.
OPTIONAL = "slbench.datasets.read.torch_adaptor"


def packages():
    """Return the packages with public names: slbench, those it names, and theirs in turn."""
    found = [sl]
    for package in found:
        children = (getattr(package, name) for name in getattr(package, "__all__", ()))
        found += [child for child in children if isinstance(child, ModuleType)]
    return found


PACKAGES = {package.__name__: package for package in packages()}
LAZY = [name for name, one in PACKAGES.items() if Path(one.__file__).with_suffix(".pyi").exists()]


def described():
    """Return every public name with its parameters, a line each; members below their class."""
    lines, seen = [], set()
    for package in PACKAGES.values():
        for name in sorted(getattr(package, "__all__", ())):
            value = getattr(package, name)
            if isinstance(value, ModuleType) or id(value) in seen:
                continue
            seen.add(id(value))
            where = f"{package.__name__}.{name}"
            lines.append(where + parameters(value))
            if inspect.isclass(value) and value.__module__.startswith("slbench"):
                lines += [f"{where}.{member}" for member in members(value)]
    return lines


def parameters(value):
    """Return the parameters of a function or class without their types."""
    made = inspect.isclass(value) and not issubclass(value, int)  # an enumeration is not
    if not (made or inspect.isroutine(value)) or not callable(value):
        return ""
    signature = inspect.signature(value)
    plain = [p.replace(annotation=p.empty) for p in signature.parameters.values()]
    return str(signature.replace(parameters=plain, return_annotation=signature.empty))


def members(kind):
    """Return the public methods and properties that a class defines itself."""
    fields = set(getattr(kind, "__dataclass_fields__", ()))  # those are its parameters
    for name in sorted({name for name in vars(kind) if not name.startswith("_")} - fields):
        value = getattr(kind, name)
        yield name + (parameters(value) if inspect.isroutine(value) else "")


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
    assert (gone, new) == ([], []), "meant? then run: python tests/test_public.py"
    assert listed == now


def test_the_flat_namespace_stays_small():
    flat = [name for name in sl.__all__ if not isinstance(getattr(sl, name), ModuleType)]
    assert 40 <= len(flat) <= 60


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


if __name__ == "__main__":
    LIST.write_text("\n".join(described()) + "\n", encoding="utf-8")
