"""csstsim: an open simulator of the CSST Survey Camera. In Python: csstsim.api, whose names are here, too."""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING

from csstsim.base.process.compiled_code import choose_folder

if TYPE_CHECKING:
    from csstsim.api import Frame, Simulation
    from csstsim.base.errors import InputError

__version__ = "0.1.0"
__all__ = ["Frame", "InputError", "Simulation"]

choose_folder(os.environ, __path__[0])


def __getattr__(name: str) -> type[Frame | Simulation | InputError]:
    """Import what is asked for when it is asked for: `import csstsim` alone, and the command line, stay quick."""
    if name in ("Frame", "Simulation"):
        return getattr(importlib.import_module("csstsim.api"), name)
    if name == "InputError":
        return importlib.import_module("csstsim.base.errors").InputError
    raise AttributeError(f"module 'csstsim' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
