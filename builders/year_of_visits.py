"""Times of a field's exposures, in visits spread over a year, so that stray light has all the levels it has in orbit.

A visit is the next pass of the field over the spacecraft's horizon: the limb sinks from LIMB_MIN to its lowest and
rises again, over the day side, the terminator or the night side, as the season has it. Nothing is random. Visits lie at
steps of the golden ratio within equal shares of the days on which the Sun is far enough, so that they meet all phases
of the Moon.
"""

from datetime import UTC, datetime, timedelta

from csstsim.instrument.pointing import mjd_utc
from csstsim.optics.sky.bodies import exposure_angles

FIRST, DAYS = datetime(2027, 6, 1, tzinfo=UTC), 365
VISITS = 24
LIMITS = {"limb": 20.0, "sun": 50.0, "moon": 20.0}  # deg, at the start and the end of each exposure
GOLDEN = (5**0.5 - 1) / 2


def visited(orbit, places, exptime, cadence):
    """Return [(ISO time, position [km], velocity [km/s])], an exposure of `exptime` s each of `places` (ra, dec [deg]).

    cadence: timedelta between the starts of a visit's exposures. States are rounded to a metre and a millimetre / s.
    """
    middle = places[len(places) // 2]
    days = [day for day in (FIRST + timedelta(days=n) for n in range(DAYS)) if _sun_is_far(orbit, middle, day)]
    share = len(days) / VISITS
    found, when = [], FIRST
    for visit in range(VISITS):
        begin, end = (len(places) * k // VISITS for k in (visit, visit + 1))
        when = max(when, days[int(share * (visit + visit * GOLDEN % 1.0))])
        for place in places[begin:end]:
            while not _allowed(orbit, place, when, exptime):
                when += cadence
            found.append((iso(when), *_rounded(orbit.state(iso(when)))))
            when += cadence
    return found


def iso(when):
    """Return a time as the survey table has it."""
    return when.strftime("%Y-%m-%dT%H:%M:%S")


def _allowed(orbit, place, when, exptime):
    for t in (when, when + timedelta(seconds=exptime)):
        angles = _angles(orbit, place, t)
        if any(angles[name] < limit for name, limit in LIMITS.items()):
            return False
    return True


def _sun_is_far(orbit, place, day):
    return all(_angles(orbit, place, day + timedelta(days=n))["sun"] >= LIMITS["sun"] for n in (0, 1))


def _angles(orbit, place, when):
    text = iso(when)
    return exposure_angles(*place, mjd_utc(text), *orbit.state(text))


def _rounded(state):
    position, velocity = state
    return tuple(round(x, 3) for x in position), tuple(round(v, 6) for v in velocity)
