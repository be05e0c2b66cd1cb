"""How Sphinx builds the pages: ``sphinx-build -n -W docs docs/_build``, without a network.

Formulas become MathML, which browsers draw themselves, by the converter in docutils. Names of other libraries are no
links: their inventories would have to be downloaded.
"""

import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.writers.html5 import HTML5Translator

sys.path.insert(0, str(Path(__file__).parent))
import public_names

import hrljax

project = "hrljax"
author = "the hrljax developers"
copyright = "the hrljax developers, Apache-2.0"
version = release = hrljax.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
templates_path = ["_templates"]
html_theme = "furo"
html_title = f"hrljax {release}"
html_math_renderer = "mathml"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["pages.css"]

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

autosummary_imported_members = True
autosummary_ignore_module_all = False
autosummary_context = {"offered": {module: public_names.of_module(module) for module in public_names.MODULES}}
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

# A name in a docstring is a link where it has a page. Public names must have one; parameters and inner modules do not.
default_role = "py:obj"
nitpick_ignore_regex = [("py:.*", rf"(?!({'|'.join(public_names.MODULES)})\.[a-zA-Z]\w*$).*")]


def formula_in_text(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def formula_on_its_line(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="formula">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def keep_lines_of_formulas(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Makes what is indented below a paragraph of a docstring, such as a formula, a literal block."""
    for i in reversed(range(2, len(lines))):
        if lines[i].startswith("    ") and not lines[i - 1]:
            above = next((line for line in reversed(lines[:i]) if line.strip()), " ")
            if not above.startswith(" ") and not above.endswith("::"):
                lines[i:i] = ["::", ""]


def check_that_every_public_name_has_a_place(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.name == "html":
        described = {name for name, *_ in app.env.get_domain("py").get_objects()}
        if missing := sorted(public_names.all_names() - described):
            raise ExtensionError(f"public names without a place in the API pages: {', '.join(missing)}")


def setup(app: Sphinx) -> None:
    app.add_html_math_renderer("mathml", (formula_in_text, None), (formula_on_its_line, None))
    app.connect("autodoc-process-docstring", keep_lines_of_formulas, priority=100)  # before napoleon
    app.connect("build-finished", check_that_every_public_name_has_a_place)
