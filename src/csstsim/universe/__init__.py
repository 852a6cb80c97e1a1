"""The embedded True Universe, made brick by brick: stars, galaxies, quasars, lensing.

May import: instrument, detector, base.
"""
