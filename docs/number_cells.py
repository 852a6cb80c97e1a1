"""A Sphinx extension: cells of tables that hold a number get the class `number`, so that site.css does not fold it.

Browsers fold lines at blanks and hyphens: a cell without either needs no class, which keeps long pages lighter.
"""

import re

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform

LONGEST = 24  # characters; a longer list of numbers may fold
_NUMBER = re.compile(r"(?=.*[ -])[<~ ]*[-+]?\d[\d.,eE+\-±%† ]*!?")


class NumberCells(SphinxPostTransform):
    """Find the cells."""

    default_priority = 900

    def run(self, **kwargs: object) -> None:
        """Add the class."""
        for cell in self.document.findall(nodes.entry):
            text = cell.astext()
            if len(text) <= LONGEST and _NUMBER.fullmatch(text):
                cell["classes"].append("number")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the transform."""
    app.add_post_transform(NumberCells)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
