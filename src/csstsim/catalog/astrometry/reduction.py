"""From catalogue positions to apparent directions at the spacecraft, and back (paper, section 5.4).

Four steps, each a function of unit vectors (n, 3) and an ephemeris.Observer, after Klioner (2003, AJ 125, 1580):

    1. space_motion      p + t (mu_east e + mu_north n + v_r varpi p)     t: years since J2000, with the Roemer delay
    2. parallax_shift    p - varpi r_observer
    3. light_deflection  by the Sun, and by Jupiter to Neptune if the observer has them
    4. aberration        exact Lorentz boost of the barycentric velocity, with the Sun's potential

Three kinds of position (ra, dec in degrees, axes of the ICRS throughout):

    catalogue at J2000   -- at_epoch (1, 2) -->   ICRS at the epoch   -- apparent (3, 4) -->   apparent
                         <-- at_j2000 ---------                       <-- icrs -------------

`icrs` needs no knowledge of the object, so it can be applied to measurements. An exposure is reduced for one instant,
its start. The header gives the state of the spacecraft at this time; from then on, fine guidance keeps the field on its
guide stars.

An unknown (NaN) proper motion, radial velocity or parallax counts as zero, and so does a negative parallax (infinite
distance: the radial velocity then has no effect). A NaN position stays NaN. Behind the Sun, deflection is that of a
point mass down to 292" from its centre, then falls to zero at the centre.

Omitted: light travel in the star's own motion (second order in v/c; erfa.pmpx omits it as well), the Earth's own
deflection (0.6 mas at the limb), the Doppler factor of the flux (1e-4).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.sphere import frames, normalised, ra_dec, unit_vectors, wrap_360
from csstsim.base.units import AU_KM, C_KM_S, DAY_S, JULIAN_YEAR_DAYS, MAS_PER_RAD

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from csstsim.base.types import FloatArray, Floats
    from csstsim.catalog.astrometry.ephemeris import Observer

_AU_YEAR = DAY_S * JULIAN_YEAR_DAYS / AU_KM  # au / yr of 1 km / s
_LIGHT_YEARS_AU = AU_KM / C_KM_S / DAY_S / JULIAN_YEAR_DAYS  # light time of 1 au, yr
_PASSES = 6  # of the inverses: each reduces the error by 1e4 far from the Sun, by 50 inside its disc


def at_epoch(
    ra: Floats,
    dec: Floats,
    observer: Observer,
    *,
    pmra: Floats = 0.0,
    pmdec: Floats = 0.0,
    parallax: Floats = 0.0,
    rv: Floats = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return the geometric positions of catalogue objects at the observer's epoch and position.

    Parameters
    ----------
    ra, dec : float or (n,) array of float
        Catalogue positions at J2000 [deg, ICRS].
    observer : Observer
        The spacecraft (catalog.astrometry.ephemeris.observer).
    pmra, pmdec : float or (n,) array of float
        Proper motion [mas / yr], pmra with cos(dec).
    parallax : float or (n,) array of float
        Parallax [mas].
    rv : float or (n,) array of float
        Radial velocity [km / s].

    Returns
    -------
    ra, dec : float or (n,) array of float
        ICRS positions at the epoch [deg].
    """
    motion = [_known(v) for v in (pmra, pmdec, np.maximum(_known(parallax), 0.0), rv)]
    return _degrees(_geometric(np.radians(ra), np.radians(dec), motion, observer))


def at_j2000(
    ra: Floats,
    dec: Floats,
    observer: Observer,
    *,
    pmra: Floats = 0.0,
    pmdec: Floats = 0.0,
    parallax: Floats = 0.0,
    rv: Floats = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return the catalogue positions at J2000 that `at_epoch` maps to the given ones.

    It does not converge if the object is closer to a pole than it has moved, because the direction of east changes.

    Parameters
    ----------
    ra, dec : float or (n,) array of float
        ICRS positions at the epoch [deg].
    observer : Observer
        The spacecraft.
    pmra, pmdec : float or (n,) array of float
        Proper motion [mas / yr], pmra with cos(dec).
    parallax : float or (n,) array of float
        Parallax [mas].
    rv : float or (n,) array of float
        Radial velocity [km / s].

    Returns
    -------
    ra, dec : float or (n,) array of float
        Positions at J2000 [deg, ICRS].
    """
    motion = [_known(v) for v in (pmra, pmdec, np.maximum(_known(parallax), 0.0), rv)]
    return _degrees(_inverse(lambda p: _geometric(*_angles(p), motion, observer), unit_vectors(ra, dec)))


def moved(ra: Floats, dec: Floats, pmra: Floats, pmdec: Floats, years: float) -> tuple[FloatArray, FloatArray]:
    """Return positions after some years of uniform motion in space, without radial velocity.

    This converts positions of another epoch to J2000.

    Parameters
    ----------
    ra, dec : float or (n,) array of float
        Positions [deg, ICRS].
    pmra, pmdec : float or (n,) array of float
        Proper motion [mas / yr], pmra with cos(dec); NaN counts as zero.
    years : float
        Time [Julian yr], negative for an earlier epoch.

    Returns
    -------
    ra, dec : float or (n,) array of float
        Positions at the other epoch [deg, ICRS].
    """
    star, east, north = frames(np.radians(ra), np.radians(dec))
    along, up = (_known(rate)[..., None] * years / MAS_PER_RAD for rate in (pmra, pmdec))
    return ra_dec(star + along * east + up * north)


def apparent(ra: Floats, dec: Floats, observer: Observer) -> tuple[FloatArray, FloatArray]:
    """Return the directions in which the observer sees objects: light deflection and aberration are applied.

    Parameters
    ----------
    ra, dec : float or (n,) array of float
        ICRS positions at the epoch [deg].
    observer : Observer
        The spacecraft.

    Returns
    -------
    ra, dec : float or (n,) array of float
        Apparent positions [deg].
    """
    return _degrees(aberration(light_deflection(unit_vectors(ra, dec), observer), observer))


def icrs(ra: Floats, dec: Floats, observer: Observer) -> tuple[FloatArray, FloatArray]:
    """Return the ICRS positions of apparent directions: the inverse of `apparent`.

    Parameters
    ----------
    ra, dec : float or (n,) array of float
        Apparent positions [deg].
    observer : Observer
        The spacecraft.

    Returns
    -------
    ra, dec : float or (n,) array of float
        ICRS positions at the epoch [deg].
    """
    return _degrees(_inverse(lambda p: aberration(light_deflection(p, observer), observer), unit_vectors(ra, dec)))


def space_motion(
    ra: Floats, dec: Floats, pmra: Floats, pmdec: Floats, parallax: Floats, rv: Floats, observer: Observer
) -> FloatArray:
    """Return vectors (n, 3) from the barycentre to the stars at the epoch, in units of their distance at J2000.

    ra, dec in rad; pmra (with cos dec), pmdec [mas/yr]; parallax [mas, >= 0]; rv [km/s].
    """
    star, east, north = frames(ra, dec)
    rates = [np.broadcast_to(v, star.shape[:-1])[..., None] / MAS_PER_RAD for v in (pmra, pmdec, parallax * rv)]
    velocity = rates[0] * east + rates[1] * north + rates[2] * _AU_YEAR * star
    # Catalogue epochs are times at which light passes the barycentre; it reaches the observer earlier or later.
    roemer = _LIGHT_YEARS_AU * np.einsum("...i,i->...", star, observer.astrom["eb"])
    return star + (observer.astrom["pmt"] + roemer)[..., None] * velocity


def parallax_shift(star: FloatArray, parallax: Floats, observer: Observer) -> FloatArray:
    """Return the unit vectors (n, 3) from the observer to stars (n, 3) as `space_motion` gives them; parallax [mas]."""
    shift = np.broadcast_to(parallax, star.shape[:-1])[..., None] / MAS_PER_RAD * observer.astrom["eb"]
    return normalised(star - shift)


def light_deflection(direction: FloatArray, observer: Observer) -> FloatArray:
    """Return unit vectors (n, 3) after deflection by the Sun (and planets), for an observer at rest."""
    import erfa

    with np.errstate(invalid="ignore"):  # of NaN
        if len(observer.bodies):
            direction = erfa.ldn(observer.bodies, observer.astrom["eb"], direction)
        return erfa.ldsun(direction, observer.astrom["eh"], observer.astrom["em"])


def aberration(direction: FloatArray, observer: Observer) -> FloatArray:
    """Return unit vectors (n, 3) as the moving observer sees them."""
    import erfa

    astrom = observer.astrom
    with np.errstate(invalid="ignore"):  # of NaN
        return erfa.ab(direction, astrom["v"], astrom["em"], astrom["bm1"])


def _geometric(ra: FloatArray, dec: FloatArray, motion: Sequence[FloatArray], observer: Observer) -> FloatArray:
    pmra, pmdec, parallax, rv = motion
    return parallax_shift(space_motion(ra, dec, pmra, pmdec, parallax, rv, observer), parallax, observer)


def _inverse(forward: Callable[[FloatArray], FloatArray], target: FloatArray) -> FloatArray:
    """Return the unit vectors that `forward`, a small displacement, takes to `target`.

    The number of passes is fixed, so that no object's position depends on the others in its array.
    """
    guess = target
    for _ in range(_PASSES):
        guess = normalised(guess + (target - forward(guess)))
    return guess


def _known(values: Floats) -> FloatArray:
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values), values, 0.0)


def _angles(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    import erfa

    return erfa.c2s(vectors)


def _degrees(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    ra, dec = _angles(vectors)
    return wrap_360(np.degrees(ra)), np.degrees(dec)
