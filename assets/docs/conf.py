"""Settings of the documentation site, which tools/docs builds.

myst-nb reads the Markdown pages and guides as they are, and runs the notebooks during the build, each once for a
version of the program. numpydoc reads the docstrings, and tools/docs_site.py adds keys, commands and labels of
cells. Furo is plain, searches without a server and fits small screens. Nothing is loaded from the network, neither
while building nor by the pages: formulas are MathML.
"""

from importlib.metadata import version as version_of
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

project = "lfmesh"
author = project_copyright = "lfmesh contributors"
version = release = version_of("lfmesh")

extensions = ["myst_nb", "numpydoc", "sphinx.ext.autodoc", "docs_site"]
root_doc = "assets/docs/index"
highlight_language = "none"
default_role = "code"

html_theme = "furo"
html_title = "lfmesh"
html_math_renderer = "mathml"
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["site.css"]

myst_heading_anchors = 3
myst_enable_extensions = ["deflist"]
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_ipywidgets_js: dict[str, Any] = {}
nb_merge_streams = True

autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False


def setup(app: Sphinx) -> None:
    """Add the renderer of formulas."""
    app.add_html_math_renderer("mathml", inline_renderers=(_inline, None), block_renderers=(_block, None))


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def _block(writer: Any, node: nodes.math_block) -> None:
    writer.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>\n')
    raise nodes.SkipNode
