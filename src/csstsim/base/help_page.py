"""The page, or the command, that explains an input; error messages name it."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import CsstsimError
from csstsim.base.shipped import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterator

PAGES = {
    "campaign": "config/README.md",
    "observation": "config/README.md",
    "survey table": "survey_tables/README.md",
    "list of pointings": "`csstsim import-pointings --help`",
    "aiming": "`csstsim aim --help`",
    "instrument": "config/instrument/README.md",
    "laboratory map": "docs/lab_maps.md",
    "table of objects": "examples/my_catalogue/README.md",
    "catalogue": "`python -m pydoc csstsim.catalog.base`",
}


@contextmanager
def explained(kind: str) -> Iterator[None]:
    """Add the page of a kind of input (PAGES) to errors raised inside; the innermost of nested contexts is used."""
    try:
        yield
    except CsstsimError as error:
        error.page = error.page or PAGES[kind]
        raise


def with_page(error: CsstsimError) -> str:
    """Return the message of a CsstsimError, with the page that explains the input, if there is one."""
    page: str | Path | None = error.page
    if page and (file := ROOT / page).is_file():
        page = file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file
    return f"{error}; see {page}" if page else str(error)
