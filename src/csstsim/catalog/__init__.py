"""The objects of the sky: catalogues, profiles, light, astrometry, and the selection of what reaches a chip.

May import: universe, instrument, detector, base.
"""
