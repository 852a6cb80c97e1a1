"""A campaign: its files, jobs, costs and progress.

May import: simulation, layers, report, render, measure, io, optics, catalog, universe, instrument, detector, base.
"""
