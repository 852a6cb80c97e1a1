"""Calibration of frames, measurement of sources and spectra, and bricks: merging and validation.

May import: optics, catalog, universe, instrument, detector, base.
"""
