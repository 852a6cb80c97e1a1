"""The documentation site: make docs (or: sphinx-build -W --keep-going -q -b html docs results/docs).

Pages are Markdown that reads the same on a git host. A link to a file of the repository that is no page
(`../config/costs.yaml`) is a relative path on a git host; here MyST makes the file a download of the site, so that no
public address of the repository is needed. Pages that live elsewhere (config/README.md, CONTRIBUTING.md, ...) are
included by a page of some lines, so each text has one home. The sentence above the include leads readers on a git host
to it, and is not on the site. A link to a file that is not there is a warning, and warnings are errors;
docs/check_links.py looks at the HTML besides.

Measured figures are links to records in the pages (benchmarks/evidence/pages.py). The site takes each from its record,
marks what is stale, and leads to its command on the page of all commands, which is made here.

Tutorials show what their cells printed and drew when docs/execute_tutorials.py executed them last (docs/tutorials/
executed). One whose code has changed since is executed anew, which takes minutes; a test finds it.

The site's search ranks pages by _static/search.js and by the words of search_words.yaml.
"""

import re
import sys
import tempfile
from pathlib import Path

from jupyter_cache import get_cache

from csstsim import __version__

sys.path.insert(0, str(Path(__file__).parent))  # execute_tutorials and the extensions of this folder
sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))  # evidence
from evidence.listing import MARK, listing
from evidence.pages import for_site

from execute_tutorials import EXECUTED, LONGEST

project = "csstsim"
version = release = __version__
author = copyright = "the csstsim contributors"
extensions = [
    "myst_nb", "sphinx.ext.autodoc", "mathml", "number_cells", "page_summaries", "plain_docstrings", "webp_pictures",
]  # fmt: skip

html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"csstsim {__version__}"
html_theme_options = {"navigation_with_keys": True}
html_static_path = ["_static"]
templates_path = ["_templates"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
highlight_language = "none"  # most blocks are commands; Python is marked as such

myst_enable_extensions = ["dollarmath"]  # formulae: $...$ in a line, $$...$$ on lines of their own
myst_heading_anchors = 4
exclude_patterns = ["tutorials/executed"]
nb_execution_mode = "cache"
_known = tempfile.TemporaryDirectory()
nb_execution_cache_path = _known.name
nb_execution_in_temp = True
nb_execution_timeout = LONGEST
nb_execution_raise_on_error = True
for file in EXECUTED.glob("*.ipynb"):
    get_cache(nb_execution_cache_path).cache_notebook_file(file, check_validity=False)


def _figures(app, page, source):
    """Put the figures of records into a page's text, and the list of commands into its page."""
    source[0] = re.sub(r"(?s)\A.*?(?=```\{include\})", "", source[0])
    source[0] = for_site(source[0].replace(MARK, listing()) if MARK in source[0] else source[0], page)


def setup(app):
    """Read each page through its records."""
    app.connect("source-read", _figures)


autodoc_member_order = "bysource"
autodoc_typehints = "none"
