"""Renders objects into an image of electrons: the drawing methods, and the choice of a method for each object.

May import: optics, catalog, universe, instrument, detector, base.
"""
