"""The report of a campaign, the figures of its bricks, and the quick look at a file.

May import: render, measure, io, optics, catalog, universe, instrument, detector, base.
"""
