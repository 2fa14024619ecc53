"""How Sphinx makes the site; `make docs` calls it.

The source folder is the root of the checkout, so that a link between a page and a notebook is the
same file path on the site, in JupyterLab and on a code host.
"""

import gc
import sys
from importlib.metadata import distribution
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE / "extensions"), str(ROOT)]

from cotlearn import __version__  # noqa: E402
from cotlearn.policies import methods, training  # noqa: E402

# with this package jsonschema builds 38 grammars of web addresses on import, which takes 2 s
sys.modules.setdefault("rfc3987_syntax", None)
gc.disable()  # pages are trees and hardly any garbage: an eighth of the time, for 0.3 GB

# `methods` imports this for type checkers only, because `training` imports it; autodoc links it
vars(methods).update(Run=training.Run)

project = "cotlearn"
author = "The cotlearn authors"
copyright = "The cotlearn authors; code MIT, text and figures CC BY 4.0"
release = version = __version__
language = "en"

# --- what belongs to the site -----------------------------------------------------------------

root_doc = "docs/index"
include_patterns = [
    "docs/**.md",
    "docs/reference/api/modules/*.rst",
    "notebooks/[0-9][0-9]_*.ipynb",
    "notebooks/laboratory/*.ipynb",
    "notebooks/extras/*.ipynb",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "data/README.md",
    "data/results/*.md",
]
exclude_patterns = [".*", "build", "cotlearn", "tests", "**/.ipynb_checkpoints", "docs/extensions"]

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinxcontrib.bibtex",
    "alternative_text",
    "colab",
    "docstrings",
    "links",
    "map_links",
    "playground",
]
suppress_warnings = ["config.cache"]

# --- pages and notebooks ----------------------------------------------------------------------

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # the outputs are those that are stored, which the tests compare
nb_merge_streams = True

# Formulas are drawn by a copy of MathJax, as pictures, so neither a font nor the network is needed.
MATHJAX = distribution("sphinx-mathjax-offline").locate_file(
    "sphinx-mathjax-offline/static/mathjax/tex-svg.js"
)
mathjax_path = MATHJAX.name

# --- API --------------------------------------------------------------------------------------

templates_path = [str(HERE / "templates")]
autosummary_ignore_module_all = False  # what a package exports is described where it exports it
# Our own names must exist; those of other packages are not looked up, for want of a network.
nitpick_ignore_regex = [(r"py:.*", r"(?!cotlearn).*")]
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_preserve_defaults = True
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike", "NDArray": "NDArray"}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
python_use_unqualified_type_names = True
add_module_names = False
default_role = "code"  # `x` in a docstring is code

# --- bibliography -----------------------------------------------------------------------------

bibtex_bibfiles = [str(HERE / "reference" / "references.bib")]
bibtex_reference_style = "author_year"
bibtex_default_style = "plain"

# --- look -------------------------------------------------------------------------------------

html_theme = "furo"
html_title = "cotlearn"
html_static_path = [str(HERE / "static"), str(MATHJAX)]
html_extra_path = [str(HERE / "root")]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_search_scorer = str(HERE / "static" / "search.js")
html_favicon = str(HERE / "static" / "favicon.svg")
html_show_search_summary = False  # needs a server; the pages also work as files
html_copy_source = False
html_show_sphinx = False
pygments_style = "friendly"
pygments_dark_style = "monokai"
html_theme_options = {
    "light_css_variables": {
        "color-brand-primary": "#0b5ea8",
        "color-brand-content": "#0b5ea8",
    },
    "dark_css_variables": {
        "color-brand-primary": "#7cc0ff",
        "color-brand-content": "#7cc0ff",
    },
}
