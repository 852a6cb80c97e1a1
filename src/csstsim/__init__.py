"""csstsim: an open simulator of the CSST Survey Camera. In Python: csstsim.api, whose names are here, too."""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

from csstsim.base.process.compiled_code import choose_folder

if TYPE_CHECKING:
    from csstsim.api import Frame, Simulation
    from csstsim.base.errors import InputError
    from csstsim.io.astropy_tables import read_spectra, read_table

__version__ = "0.2.0"  # its only home; CITATION.cff repeats it
# Public names, by the module that has them; each is imported when it is asked for, so the command line starts quickly
_HOMES = {
    "Frame": "csstsim.api",
    "InputError": "csstsim.base.errors",
    "Simulation": "csstsim.api",
    "read_spectra": "csstsim.io.astropy_tables",
    "read_table": "csstsim.io.astropy_tables",
}
__all__ = ["Frame", "InputError", "Simulation", "read_spectra", "read_table"]

choose_folder(os.environ, __path__[0])


def __getattr__(name: str) -> Any:
    """Import a public name."""
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'csstsim' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__all__, "__version__"]
