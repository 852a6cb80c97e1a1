"""The layers of the paper's Appendix B, one module per keyword (lower case). No layer imports another.

May import: simulation, report, render, measure, io, optics, catalog, universe, instrument, detector, base.
"""
