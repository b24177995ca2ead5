"""How the documentation is built: ``make docs``, or ``sphinx-build -n -W docs out/docs``.

The site needs no network.  Formulas are MathML, which browsers draw themselves: no script and
no font is loaded.  A formula that the converter does not understand is a warning, and warnings
fail the build.
"""

import pkgutil
import re
from typing import Any

from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging

import slbench

project = "slbench"
author = "The slbench authors"
copyright = "The slbench authors"
version = release = slbench.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
nitpicky = True
# Only references into the package itself are checked: nothing outside is looked up.
nitpick_ignore_regex = [("py:.*", r"(?!slbench\.).*")]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = "slbench"
html_static_path = ["_static"]
html_css_files = ["slbench.css"]
html_copy_source = False
html_show_sourcelink = False
html_math_renderer = "mathml"
highlight_language = "none"

_log = logging.getLogger(__name__)


def mathml(tex: str, display: str) -> str:
    """Convert TeX to MathML; what was not understood is left in it as TeX, and reported."""
    # The converter leaves no space before the name of a function.
    spaced = re.sub(r"(?<=[\w)}]) *\\(cos|sin|tanh|exp|log|ln)\b", r"\\,\\\1", tex.strip())
    markup = convert(spaced, display=display)
    text = re.sub(r"<[^>]*>", "", markup)
    if "\\" in text or "&amp;" in text or "<merror" in markup:
        _log.warning("formula not understood: %s", tex, type="mathml")
    return markup


def _inline(self: Any, node: Any) -> None:
    self.body.append(mathml(node.astext(), "inline"))
    _skip()


def _block(self: Any, node: Any) -> None:
    self.body.append(f'<div class="math">{mathml(node.astext(), "block")}</div>')
    _skip()


def _skip() -> None:
    from docutils.nodes import SkipNode

    raise SkipNode


def _named_only(app: Sphinx, env: Any, node: Any, contents: Any) -> Any:
    """Leave a reference to something of ours that has no entry as text, if it exists at all."""
    if node.get("refdomain") != "py" or not node["reftarget"].startswith("slbench."):
        return None
    try:
        pkgutil.resolve_name(node["reftarget"])
    except (ImportError, AttributeError):
        return None  # a broken reference: nitpicky reports it
    return contents


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer of formulas."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.connect("missing-reference", _named_only)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
