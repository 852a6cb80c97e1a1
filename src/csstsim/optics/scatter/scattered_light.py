"""Light of a point source beyond the box of the stored PSF: the wing and the ghosts of one chip's filter.

They are made from the camera's data and stored in the attributes of the PSF file, so that a PSF set describes all of a
star's light. A set without these attributes (of another camera, or an external one) has no wings and no ghosts.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from csstsim.base.errors import InputError
from csstsim.optics.scatter.ghosts import Ghosts, make_ghosts
from csstsim.optics.scatter.halo import Wing, make_wing

if TYPE_CHECKING:
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.filter import Filter
    from csstsim.optics.psf.psf_file import PsfSet


@dataclass(frozen=True, eq=False)
class Scattered:
    """Wing and ghosts; None where there are none."""

    wing: Wing | None = None
    ghosts: Ghosts | None = None

    def attributes(self) -> dict[str, str]:
        """Return {name: JSON} of the parts that are not None; `read_scattered` is the inverse."""
        return {name: json.dumps(part.as_dict()) for name, part in vars(self).items() if part is not None}


def scattered_light(camera: Camera, filter: Filter) -> Scattered:
    """Return the `Scattered` of a camera's filter. Raises InputError (optics.scatter.halo, optics.scatter.ghosts)."""
    return Scattered(
        make_wing(camera.scatter, filter.psf_wavelength, camera.telescope),
        make_ghosts(camera.ghosts, filter.name, camera.telescope, camera.detector.pixel_um),
    )


def read_scattered(psf: PsfSet) -> Scattered:
    """Return the `Scattered` of a PsfSet. Raises InputError if its attributes are damaged."""
    kinds: dict[str, Any] = {"wing": Wing, "ghosts": Ghosts}
    try:
        return Scattered(**{k: c.read(json.loads(psf.attributes[k])) for k, c in kinds.items() if k in psf.attributes})
    except (AttributeError, LookupError, TypeError, ValueError) as exc:
        raise InputError(
            f"the PSF file is damaged: {type(exc).__name__} {exc}", file=psf.path, key="wing, ghosts"
        ) from exc
