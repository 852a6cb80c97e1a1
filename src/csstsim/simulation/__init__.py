"""The simulation of one job: its state, the ordered layers, and the contract of a layer.

May import: layers, report, render, measure, io, optics, catalog, universe, instrument, detector, base.
"""
