"""Sky background: one constant per band (paper section 5.5.1; zodiacal light, earthshine and the rest come
as a stray-light model later). The rate is the filter's `sky`, e-/s/px, from config/instrument/filters.yaml.
"""


def sky_electrons(filter_, exptime):
    """Return the expected sky in one pixel [e-] for an exposure of `exptime` seconds."""
    return filter_.sky * exptime
