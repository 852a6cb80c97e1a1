"""The documentation site: make docs (or: sphinx-build -W --keep-going -q -b html docs results/docs).

Pages are Markdown that reads the same on a git host. A link to a file of the repository that is no page
(`../config/costs.yaml`) is a relative path on a git host; here MyST makes the file a download of the site, so that no
public address of the repository is needed. Pages that live elsewhere (config/README.md, CONTRIBUTING.md, ...) are
included by a page of three lines, so each text has one home. A link to a file that is not there is a warning, and
warnings are errors; docs/check_links.py looks at the HTML besides.

Notebooks (docs/tutorials) are not executed here: make tutorials does.
"""

import sys
from pathlib import Path

from nbclient import NotebookClient

sys.path.insert(0, str(Path(__file__).parent))  # plain_docstrings

project = "csstsim"
author = copyright = "the csstsim contributors"
extensions = ["myst_nb", "sphinx.ext.autodoc", "plain_docstrings"]

html_theme = "furo"
html_title = "csstsim"
html_theme_options = {"navigation_with_keys": True}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
highlight_language = "none"  # most blocks are commands; Python is marked as such

myst_enable_extensions = ["dollarmath"]  # formulae: $...$ in a line, $$...$$ on lines of their own
myst_heading_anchors = 4
nb_execution_mode = "off"
nb_execution_in_temp = True
nb_execution_timeout = 1800  # s a cell: a campaign runs in one
nb_execution_raise_on_error = True
NotebookClient.coalesce_streams = True  # a command's output comes in pieces, cut anywhere

autodoc_member_order = "bysource"
autodoc_typehints = "none"
