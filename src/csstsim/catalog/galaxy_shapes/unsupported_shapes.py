"""Columns for galaxies' shapes that csstsim does not use, and what to give instead.

Tables often have axis ratios, position angles and other names of Sersic indices. A galaxy is rendered only from
size_disk, size_bulge, bulge_frac, n_disk, n_bulge, e1, e2, kappa, gamma1 and gamma2. A shape given only by other
columns would be ignored without a warning: the galaxy would be round, or have another profile. So such columns are
refused.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.catalog.table import COLUMNS, GALAXY, OPTIONAL

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import ArrayLike

    from csstsim.base.types import AnyArray, PathLike

# (columns to give instead, how to fill them, names refused, compared without case, punctuation, units and bands)
_PARTS = (
    (
        ("n_disk", "n_bulge", "bulge_frac"),
        "n_disk, n_bulge: Sersic indices, 0.3 to 6.2, of the disk and of the fraction bulge_frac of the flux; a table "
        "may give n, of the total flux",
        "n nsersic galindex sersic sersicn sersicindex sersicnindex nser nindex ndisk nbulge sersicdisk sersicbulge",
    ),
    (
        ("bulge_frac",),
        "bulge_frac: the bulge's fraction of the flux",
        "bt bovert bulgetototal bulgetotal bulgefraction bulgeratio fbulge fracdev",
    ),
    (
        ("e1", "e2"),
        "e1 = -e cos(2 PA), e2 = e sin(2 PA); e = (1 - q) / (1 + q), q = b / a, PA from north through east",
        "q qdisk qbulge axisratio axialratio axratio ba badisk babulge bovera aoverb aimage bimage aworld bworld "
        "semimajor semiminor semimajoraxis semiminoraxis majoraxis minoraxis elongation inclination incl "
        "e ell ellip galellip ellipticity eps epsilon eccentricity flattening "
        "pa galpa padisk pabulge posang posangle positionangle theta thetaimage thetaworld thetasky thetaj2000 phi "
        "angle orientation e1 e2 eps1 eps2 epsilon1 epsilon2 ell1 ell2 ellip1 ellip2 ellipticity1 ellipticity2 "
        "chi1 chi2",
    ),
    (
        ("size", "size_disk", "size_bulge"),
        "size (or size_disk, size_bulge): arcsec, half-light radius along the circle of equal area, sqrt(q) r_e",
        "re galre redisk rebulge reff reffective effectiveradius rh rhl rhalf halflight halflightradius hlr hlrdisk "
        "hlrbulge r50 radius radiusdisk radiusbulge rd rscale scalelength fluxradius petror50 petrorad "
        "devrad exprad fwhm sizedisk sizebulge size",
    ),
    (
        ("gamma1", "gamma2"),
        "gamma1, gamma2 and kappa, of lensing: axis 1 along +RA, axis 2 at 45 deg towards north",
        "g1 g2 shear1 shear2 shearg1 shearg2 gamma1 gamma2",
    ),
)
_ADVICE = {word: (ours, advice) for ours, advice, words in _PARTS for word in words.split()}
_UNIT = re.compile(r"[^a-z0-9](arcsecs?|as|deg|degrees?|rad|radians?|pix|pixels?|px)\W*$")
# Band suffixes of such names, from any survey
_BAND = re.compile(r"(^[nq]|(?<=[a-z0-9_]{2}))[^a-z0-9](nuv|u|g|r|i|z|y|vis)$")


def advice_for(name: str, given: Iterable[str]) -> str | None:
    """Return advice on what to give instead of a galaxy's column `name`.

    Return None if it is not a shape, or if a column to give instead is present. given: the names of all columns.
    """
    if name in COLUMNS or name in OPTIONAL or name == "size" or name.startswith("mag_"):
        return None
    word = name.strip().lower()
    for ending, instead in ((_UNIT, ""), (_BAND, r"\1"), (_UNIT, "")):
        word = ending.sub(instead, word)
    ours, advice = _ADVICE.get(re.sub(r"[^a-z0-9]", "", word), ((), None))
    return None if set(ours) & set(given) else advice


def check_shapes(columns: Mapping[str, list[Any] | AnyArray], obj_type: ArrayLike, where: PathLike) -> None:
    """Raise InputError for a column of galaxies' shapes that is ignored, if the columns to give instead are missing.

    columns: {name: (n,) values}, names as the user has them; obj_type (n,). Columns that are blank for every galaxy are
    allowed.
    """
    galaxies = np.flatnonzero(np.asarray(obj_type) == GALAXY)
    for name, values in columns.items() if galaxies.size else ():
        advice = advice_for(name, columns)
        if advice and any(not _blank(values[row]) for row in galaxies):
            raise InputError("galaxies are not rendered from this column", file=where, key=name, allowed=advice)


def _blank(value: Any) -> bool:
    return (
        value is None or (isinstance(value, str) and not value.strip()) or bool(np.isscalar(value) and value != value)
    )
