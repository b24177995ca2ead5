"""Pictures of values: the function that draws a type, found by its dotted name.

Which function draws what is a table of :mod:`slbench.report.plots`, and of installed packages
(entry-point group ``slbench.drawers``): a value says ``figure(self)`` and imports neither the
function nor matplotlib.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from slbench.core.errors import InputError
from slbench.core.io.atomic import atomic_path
from slbench.core.registry import Registry, resolved

#: Where the rows of slbench's own types stand.
_ROWS = "slbench.report.plots:DRAWERS"


def figure(value: Any, **options: Any) -> Any:
    """Draw a value.

    Parameters
    ----------
    value : object
        Of a type with a drawer, or of a type derived from one.
    **options
        For the drawer.

    Returns
    -------
    matplotlib Figure

    Raises
    ------
    InputError
        If nothing draws this type.
    """
    drawers: Registry[Any] = Registry("drawer", "slbench.drawers", resolved(_ROWS))
    for kind in type(value).__mro__:
        name = f"{kind.__module__}:{kind.__qualname__}"
        if name in drawers:
            return drawers.get(name)(value, **options)
    raise InputError("plot", "a value that has a drawer", type(value).__name__)


#: How a figure becomes a PNG: without the name of the library and its version, so that equal
#: figures are equal files.
PNG: dict[str, Any] = {"format": "png", "metadata": {"Software": None}}


def save_png(drawn: Any, target: Any) -> None:
    """Save a matplotlib figure as a PNG.

    Parameters
    ----------
    drawn : matplotlib Figure
    target : path or binary file
        A path is written to as a whole or not at all.
    """
    if not isinstance(target, str | Path):
        drawn.savefig(target, **PNG)
        return
    with atomic_path(target) as temporary:
        drawn.savefig(temporary, **PNG)


def write_figure(value: Any, path: str | Path, **options: Any) -> None:
    """Draw a value into a PNG file; see :func:`figure`."""
    save_png(figure(value, **options), path)
