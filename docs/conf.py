"""How Sphinx builds these pages: `make docs`, into docs/_build/html.

Equations are drawn by matplotlib, so that the pages need neither the network nor fonts for mathematics.
"""

import html
import re
from importlib import metadata

from docutils import nodes
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.textpath import TextPath
from sphinx.application import Sphinx
from sphinx.util.logging import getLogger
from sphinx.util.typing import ExtensionMetadata
from sphinx.writers.html5 import HTML5Translator

project = "scan3d"
release = metadata.version("scan3d")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

# In docstrings single backticks mark both names and formulas; documented names become links.
default_role = "py:obj"
# Public names must be documented; names inside of packages need not be, and those of other projects would need the network.
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!(planar|scan3d)\.\w+$).*")]
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "undoc-members": True}
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Index")}
autosummary_generate = False
python_use_unqualified_type_names = True

html_theme = "pydata_sphinx_theme"
html_title = "scan3d"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_copy_source = False
templates_path = ["_templates"]
# the four groups of pages at the left, and nothing of them in the header
html_sidebars = {"**": ["groups.html"]}
html_theme_options = {
    "navbar_center": [],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": [],
    "footer_end": [],
}
html_math_renderer = "drawn"

# Size of the font of the drawn equations in points, and the number of these points in one em of the text: with it letters in
# equations have the height of those in the text.
_POINTS, _EM = 12.0, 10.5
# Path segments of matplotlib as the commands of SVG.
_SEGMENTS = {Path.MOVETO: "M", Path.LINETO: "L", Path.CURVE3: "Q", Path.CURVE4: "C", Path.CLOSEPOLY: "Z"}
# Types of arrays after evaluation, and as they are written in the code.
_TYPE_SPELLINGS = [
    (
        r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[~?(?:numpy\.)?(\w+)\]\]",
        r"NDArray[\1]",
    ),
    (r"TypeAliasForwardRef\('(\w+)'\)", r"\1"),
]


def inline_math(translator: HTML5Translator, node: nodes.math) -> None:
    """An equation within a line."""
    translator.body.append(_drawn(node))
    raise nodes.SkipNode


def displayed_math(translator: HTML5Translator, node: nodes.math_block) -> None:
    """An equation on a separate line."""
    translator.body.append(f'<div class="equation">{_drawn(node)}</div>')
    raise nodes.SkipNode


def _drawn(node: nodes.Element) -> str:
    """An equation as SVG, with letters of the size of the surrounding text."""
    tex = " ".join(node.astext().split())
    try:
        path = TextPath((0, 0), f"${tex}$", size=_POINTS, prop=FontProperties(math_fontfamily="cm"))
    except ValueError as error:
        getLogger(__name__).warning("equation: %s", error, location=node)
        return ""
    box = path.get_extents().padded(0.5)
    outline = " ".join(
        _SEGMENTS[code] + ",".join(f"{value:.2f}" for value in ([] if code == Path.CLOSEPOLY else values))
        for values, code in path.iter_segments(simplify=False)
    )
    size = f"width:{box.width / _EM:.3f}em;height:{box.height / _EM:.3f}em;vertical-align:{box.y0 / _EM:.3f}em"
    view = f"{box.x0:.2f} {-box.y1:.2f} {box.width:.2f} {box.height:.2f}"
    label = html.escape(tex)
    return (
        f'<svg class="equation" role="img" aria-label="{label}" style="{size}" viewBox="{view}">'
        f'<path fill="currentColor" transform="scale(1,-1)" d="{outline}"/></svg>'
    )


def short_types(
    _app: Sphinx, _what: str, _name: str, _object: object, _options: object, arguments: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """The signature with the types of arrays as they are written in the code."""
    for long, short in _TYPE_SPELLINGS:
        arguments, returned = (text and re.sub(long, short, text) for text in (arguments, returned))
    return arguments, returned


def setup(app: Sphinx) -> ExtensionMetadata:
    app.add_html_math_renderer("drawn", (inline_math, None), (displayed_math, None))
    app.connect("autodoc-process-signature", short_types)
    return {"parallel_read_safe": True}
