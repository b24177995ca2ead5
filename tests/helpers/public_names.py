"""The public names of slbench with their parameters, and the list of them.

``python tests/helpers/public_names.py`` writes the list anew after a change that is meant.
"""

import inspect
import pkgutil
from pathlib import Path
from types import ModuleType

import slbench as sl

LIST = Path(__file__).parents[1] / "public-names.txt"


def packages():
    """Return the packages with public names: slbench, those it names, and theirs in turn."""
    found = [sl]
    for package in found:
        inside = {one.name for one in pkgutil.iter_modules(package.__path__)}
        children = (getattr(package, name) for name in inside & {*getattr(package, "__all__", ())})
        found += sorted(filter(inspect.ismodule, children), key=lambda child: child.__name__)
    return found


PACKAGES = {package.__name__: package for package in packages()}


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


if __name__ == "__main__":
    LIST.write_text("\n".join(described()) + "\n", encoding="utf-8")
