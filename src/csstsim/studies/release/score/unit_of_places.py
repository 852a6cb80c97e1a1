"""Places in another unit than degrees that happen to lie in the field, as hours do near a right ascension of 0."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.studies.release.score.match import matched

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, PathLike
    from csstsim.studies.release.score.catalogue import Catalogue

FEWEST = 5  # objects that have a source in the other unit; of a smaller catalogue: all sources
MORE = 10  # times as many as in degrees
RADIAN = 180 / np.pi
UNITS = {"ra_hour": (15.0, 1.0), "ra_rad, dec_rad": (RADIAN, RADIAN), "ra_rad": (RADIAN, 1.0)}  # of ra and dec


def check_unit(
    truth: Mapping[str, AnyArray],
    sources: Catalogue,
    found: int,
    inside: Callable[[FloatArray, FloatArray], BoolArray],
    radius: float,
    file: PathLike | None = None,
) -> None:
    """Raise InputError if places match no object, but would in another unit.

    truth, sources: with ra, dec [deg]; found: objects that have a source; inside: function of ra, dec [deg] that tells
    which places the field has; radius: arcsec.
    """
    few = min(FEWEST, len(sources))
    for unit, (of_ra, of_dec) in UNITS.items():
        ra = of_ra * sources["ra"]
        dec = of_dec * sources["dec"]
        there = (np.abs(dec) <= 90.0) & (np.abs(ra) <= 720.0)
        there[there] = inside(ra[there], dec[there])
        if there.sum() < max(few, 1):
            continue
        other = int(matched(truth, {"ra": ra[there], "dec": dec[there]}, radius=radius).found.sum())
        if other >= few and other > MORE * found:
            raise InputError(
                f"{found} true objects have a source; {other} would, if the places were {unit}",
                file=file,
                key="ra, dec",
                allowed=f"degrees; for another unit --map {unit.split(',')[0]}=COLUMN",
            )
