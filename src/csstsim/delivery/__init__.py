"""`csstsim verify`: checks that a campaign's output folder is complete and sound, and writes its manifest.

May import: stages, campaign, simulation, layers, report, render, measure, io, optics, catalog, universe, instrument,
detector, base.
"""
