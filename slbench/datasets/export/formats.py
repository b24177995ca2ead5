"""Other layouts of a data set, by name: those of this package, and those that were added.

A sample at a time goes from its shard into the new files, so memory and temporary disk stay
those of one sample; what is written appears under its name when it is complete.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from slbench.core.errors import InputError
from slbench.core.io import OutputFolder, atomic_path, check_writable
from slbench.datasets.export.registry import exporters
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Recipe

#: Exporters write what they like, into a folder of their own.
EXPORT_FOLDER = OutputFolder("export", ("*",))


def check_target(form: str, out: Path) -> None:
    """Refuse a format that is none, or a target that exists.

    Raises
    ------
    InputError
        For another format, or a file or a folder with something in it at `out`.
    """
    suffixes = exporters.get(form, "--format").suffixes
    if suffixes and out.suffix.lower() not in suffixes:
        expected = f"for {form} a file that ends in {' or '.join(suffixes)}"
        raise InputError("--out", expected, out)
    if out.is_file() or (out.is_dir() and (suffixes or any(out.iterdir()))):
        raise InputError("--out", "a name that is not taken", f"{out}, which exists")
    check_writable(out, "--out")


def export(
    data: Dataset,
    out: str | Path,
    form: str,
    recipe: Recipe | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> int:
    """Write a selection of a data set in another layout.

    Parameters
    ----------
    data : Dataset
    out : str or Path
        A folder, or for HDF5 a file, that does not exist.
    form : str
        One of :data:`~slbench.datasets.export.registry.exporters`: ``"frames"``, ``"hdf5"``,
        ``"bop"``, ``"coco"``, ``"clouds"``, ``"fringe-depth"``, ``"light-transport"`` (see the
        modules of this package), or one that was added.
    recipe : Recipe, optional
        Patterns and noise; the first stored capture of each sample by default.
    on_progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    int
        Number of samples written.

    Raises
    ------
    InputError
        If the target is taken, nothing is selected, a sample cannot be read, or it has no
        place in the layout.  Nothing is left then.
    """
    target = Path(out)
    check_target(form, target)
    recipe = recipe or Recipe(None)
    if not len(data):
        raise InputError("data set", "at least one sample to export", "none")
    exporter = exporters.get(form)
    if exporter.suffixes:
        with atomic_path(target) as temporary:
            for done in exporter.write(data, recipe, temporary):
                _report(on_progress, done, data)
        return len(data)
    parameters = {
        "dataset": data.manifest.name,
        "format": form,
        "patterns": None if recipe.patterns is None else str(recipe.patterns),
        "noise": recipe.noise,
        "samples": len(data),
    }
    with EXPORT_FOLDER.writing(target, parameters, recipe.seed) as temporary:
        for done in exporter.write(data, recipe, temporary):
            _report(on_progress, done, data)
    return len(data)


def _report(on_progress: Callable[[float], None] | None, done: int, data: Dataset) -> None:
    if on_progress:
        on_progress(done / len(data))
